"""`python -m leglab` is the command line."""

from leglab.cli import main

if __name__ == "__main__":
    main()
