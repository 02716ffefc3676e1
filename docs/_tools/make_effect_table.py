"""Writes docs/reference/effect_table.md: `python docs/_tools/make_effect_table.py`."""

from itertools import groupby
from pathlib import Path

from leglab.diagnosis.effects import Effect, all_effects

PAGE = Path(__file__).parents[1] / "reference" / "effect_table.md"


def markdown_table() -> str:
    """Names by group with physics, source and the excitation that shows them."""
    lines = [
        "# Effects that the diagnosis can name",
        "",
        "Made by `python docs/_tools/make_effect_table.py`.",
    ]
    known = all_effects()
    rows = sorted(
        (e for e in known if e.nameable),
        key=lambda effect: (effect.group, effect.name, effect.physics),
    )
    for group, effects in groupby(rows, key=lambda effect: effect.group):
        lines += ["", f"## {group}", ""]
        lines += ["| name | physics | shown by | source |", "|---|---|---|---|"]
        lines += [_row(effect) for effect in effects]
    lines += ["", "## Calibrated, never named", ""]
    shapes = "What good machines differ in beside the above: shapes of laws, and mountings."
    lines += [shapes, ""]
    lines += ["| name | physics | shown by | source |", "|---|---|---|---|"]
    lines += [_row(effect) for effect in known if not effect.nameable]
    return "\n".join(lines) + "\n"


def _row(effect: Effect) -> str:
    cells = (effect.physics, effect.excitation, effect.source)
    text = " | ".join(" ".join(cell.split()).replace("|", "\\|") for cell in cells)
    return f"| `{effect.name}` | {text} |"


if __name__ == "__main__":
    PAGE.write_text(markdown_table())
