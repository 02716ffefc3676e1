"""Looks for bytes that a reader trips over: `python -m tests.fuzz.run NAME [--seconds 300]`.

Needs atheris (`pip install 'atheris>=3,<4'`), which follows the branches that an input takes and
keeps those inputs that take new ones. Begins with the committed corpus; inputs found go to
out/fuzz/NAME, and what breaks a reader to out/fuzz/NAME-crash-*: put it into tests/fuzz/corpus/NAME
with the repair, so that `tests/test_fuzz.py` replays it.
"""

import argparse
import inspect
import sys
from pathlib import Path

import atheris

from tests.fuzz.targets import CORPUS, TARGETS, one_input

OUT = Path("out") / "fuzz"


def instrument(packages: tuple[str, ...]) -> int:
    """Has the functions of packages tell the fuzzer which branches they take; returns how many.

    After the loading, which atheris' hook of imports would count as branches of the first input.
    """
    found = set()
    for name, module in list(sys.modules.items()):
        if not any(name == package or name.startswith(f"{package}.") for package in packages):
            continue
        for value in vars(module).values():
            inner = vars(value).values() if inspect.isclass(value) else (value,)
            for one in inner:
                function = inspect.unwrap(getattr(one, "__func__", one))
                if inspect.isfunction(function) and function.__module__ == name:
                    found.add(function)
    for function in found:
        atheris.instrument_func(function)
    return len(found)


def main() -> None:
    """Runs until the time is over or a reader trips."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("name", choices=sorted(TARGETS))
    parser.add_argument("--seconds", type=int, default=300)
    parser.add_argument("--most-bytes", type=int, default=4096, help="of an input")
    asked = parser.parse_args()
    # What readers load when they are first called is loaded before it is instrumented.
    for path in sorted((CORPUS / asked.name).iterdir()):
        one_input(asked.name, path.read_bytes())
    print(f"{instrument(TARGETS[asked.name].modules)} functions instrumented", file=sys.stderr)
    found = OUT / asked.name
    found.mkdir(parents=True, exist_ok=True)
    options = [
        f"-max_total_time={asked.seconds}",
        f"-max_len={asked.most_bytes}",
        f"-artifact_prefix={found}-",
        "-timeout=30",
        "-rss_limit_mb=4096",
        "-print_final_stats=1",
    ]
    atheris.Setup(
        [sys.argv[0], *options, str(found), str(CORPUS / asked.name)],
        lambda content: one_input(asked.name, content),
    )
    atheris.Fuzz()


if __name__ == "__main__":
    main()
