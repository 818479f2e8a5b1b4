"""The description of a study: the blocks, the protocol and the rig, and the file that they are read from."""
