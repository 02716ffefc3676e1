"""All that measures leglab, by name: `python -m benchmarks NAME [OPTIONS]`."""

import ast
import runpy
import sys
from pathlib import Path

FOLDER = Path(__file__).parent


def scripts() -> dict[str, Path]:
    """The scripts by name: those files of the folder that can be run."""
    files = sorted(FOLDER.glob("*.py"))
    return {f.stem: f for f in files if f.stem[0] != "_" and "__main__" in f.read_text()}


def main() -> None:
    """Runs the script of that name; without one, lists them."""
    known = scripts()
    if len(sys.argv) < 2 or sys.argv[1] in ("-h", "--help"):
        for name, file in known.items():
            told = ast.get_docstring(ast.parse(file.read_text())) or ""
            line = told.partition("\n")[0].partition(": `")[0].rstrip(".")
            print(f"{name:24} {line}")
        return
    name = sys.argv[1]
    if name not in known:
        raise SystemExit(f"error: no benchmark {name!r}; allowed: {', '.join(known)}")
    sys.argv = [str(known[name]), *sys.argv[2:]]
    sys.path.insert(0, str(FOLDER))
    runpy.run_path(str(known[name]), run_name="__main__")


if __name__ == "__main__":
    main()
