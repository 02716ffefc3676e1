"""The commands of a new user's first day; what they print is kept in docs/development/notes."""

import pytest

from tests.helpers.first_day import PAGE, first_day

pytest.importorskip("duckdb")


@pytest.mark.slow("the commands of a day")
def test_a_first_day_has_no_surprises(tmp_path):
    day = first_day(tmp_path)
    by_command: dict[str, list] = {}
    for step in day.steps:
        by_command.setdefault(step.command, []).append(step)
        assert "Traceback" not in step.output, step.output
        if step.status == 2:
            lines = [line for line in step.output.splitlines() if line.startswith("error: ")]
            assert len(lines) == 1, step.output
    # The kept output is that of these commands.
    kept = PAGE.read_text()
    for command in by_command:
        assert command in kept, "run python -m tests.helpers.first_day"
    compare = [s for c, steps in by_command.items() if c.startswith("compare") for s in steps]
    assert "8 of 8 runs were there; written to out/compare" in compare[1].output
    interrupted, resumed, edited = by_command["sweep sweep.toml --load mine.py --out out/sweep"][1:]
    assert interrupted.status == 130
    assert "the same command goes on from there" in interrupted.output
    assert "were there; written to out/sweep" in resumed.output
    assert "was begun with other code of leglab or of a plug-in" in edited.output
    wrong = by_command["sweep sweep.toml --load mine.py --out out/sweep"][0]
    assert "unknown setting" in wrong.output
    (anew,) = by_command["sweep sweep.toml --load mine.py --out out/sweep --overwrite"]
    assert "12 of 12 runs made; written to out/sweep" in anew.output
    (diagnosed,) = (s for c, (s, *_) in by_command.items() if "--columns map.toml --out" in c)
    assert diagnosed.status == 0
    assert (tmp_path / "out" / "index.html").is_file()
