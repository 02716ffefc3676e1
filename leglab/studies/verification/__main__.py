"""Runs every check: `python -m leglab.studies.verification`; exit status 1 where one fails.

`--markdown` prints the worst row of each case in MuJoCo, the table of docs/concepts/physics.md.
"""

import sys

from leglab.studies.verification.report import markdown, verify

if __name__ == "__main__":
    if sys.argv[1:] == ["--markdown"]:
        print(markdown(), end="")
        sys.exit(0)
    sys.exit(0 if verify() else 1)
