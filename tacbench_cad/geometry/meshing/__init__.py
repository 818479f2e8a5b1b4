"""How the mesh of a block is made from its formula, and what is proved of it."""
