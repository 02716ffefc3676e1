"""Runs every check: `python -m leglab.verification`; exit status 1 where one fails."""

import sys

from leglab.verification.report import verify

if __name__ == "__main__":
    sys.exit(0 if verify() else 1)
