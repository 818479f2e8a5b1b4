"""``python -m tacbench_cad``: the same as the command ``tacbench``."""

import sys

from tacbench_cad.cli import main

if __name__ == "__main__":
    sys.exit(main())
