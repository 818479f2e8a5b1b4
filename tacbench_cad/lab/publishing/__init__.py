"""A study as it is published: run folders, blocks' files and report as an RO-Crate. Nothing is uploaded."""
