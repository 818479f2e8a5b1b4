"""The steps from the options of ``tacbench make`` to checked files in a folder."""
