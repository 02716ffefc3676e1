"""The command line: the `leglab` command, and `python -m leglab`."""

import sys


def main() -> None:
    """Runs the command line; Ctrl-C while it is loaded is one line as well."""
    try:
        try:
            from leglab.cli import main as run
        except (ImportError, MemoryError, OSError) as error:
            reason = " ".join(str(error).split()) or "out of memory"
            print(f"error: leglab cannot be loaded: {reason}", file=sys.stderr)
            sys.exit(2)
        run()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
