"""Run the command ``tacbench`` as ``python -m tacbench_cad``."""

import sys

from tacbench_cad.cli import main

if __name__ == "__main__":
    sys.exit(main())
