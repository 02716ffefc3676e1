"""The command line: the `leglab` command, and `python -m leglab`."""

import sys


def main() -> None:
    """Runs the command line; Ctrl-C while it is loaded is one line as well."""
    try:
        from leglab.cli import main as run

        run()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
