"""Looks for bytes that a reader trips over: `python -m tests.fuzz.run NAME [--seconds 300]`.

Needs atheris (`pip install 'atheris>=3,<4'`), which follows the branches that an input takes and keeps
those inputs that take new ones. Begins with the committed corpus; inputs found go to
out/fuzz/NAME, and what breaks a reader to out/fuzz/NAME-crash-*: put it into tests/fuzz/corpus/NAME
with the repair, so that `tests/test_fuzz.py` replays it.
"""

import argparse
import sys
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["leglab", "mcap", "mcap_ros2"]):
    from tests.fuzz.targets import CORPUS, TARGETS, one_input

OUT = Path("out") / "fuzz"


def main() -> None:
    """Runs until the time is over or a reader trips."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("name", choices=sorted(TARGETS))
    parser.add_argument("--seconds", type=int, default=300)
    parser.add_argument("--most-bytes", type=int, default=4096, help="of an input")
    asked = parser.parse_args()
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
