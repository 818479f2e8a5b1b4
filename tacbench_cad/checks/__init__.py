"""The single checks that verification and identification of files are made of."""
