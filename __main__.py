"""`python -m hulldown` runs the command line."""

import sys

from hulldown.cli import main

if __name__ == "__main__":
    sys.exit(main())
