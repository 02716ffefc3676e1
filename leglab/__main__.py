"""The command line: the `leglab` command, and `python -m leglab`."""

import sys
import warnings


def main() -> None:
    """Runs the command line; Ctrl-C while it is loaded is one line as well.

    What libraries warn of is shown to those alone who ask by `python -W default` or PYTHONWARNINGS.
    """
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
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
