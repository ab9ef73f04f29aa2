"""Regenerate the paper's tables and figures: ``python paper_tables.py [--run]``.

The same as ``crowdbench tables``.
"""

import sys

from crowdbench.cli import main

if __name__ == "__main__":
    sys.exit(main(["tables", *sys.argv[1:]]))
