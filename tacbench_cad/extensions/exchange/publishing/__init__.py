"""Publication of a study as an RO-Crate with the run folders, the files of the blocks and the report (no upload)."""
