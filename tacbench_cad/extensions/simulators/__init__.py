"""Export of textures to simulators: each texture gets a folder with the files of each engine and a note about them.

A print format (:mod:`tacbench_cad.formats`) writes one part into one file. A target of this package writes several
files that refer to each other, so all files of a texture must stay in one folder. No target needs an optional package.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
