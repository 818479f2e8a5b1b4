"""Everything beyond making, pressing and analysing blocks.

Each folder is one extension, and may be deleted: the rest works without it. An extension uses only public names of the
core, and is found through Python entry points, in the same way as a package of somebody else.
"""
