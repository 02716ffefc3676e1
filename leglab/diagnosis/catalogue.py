"""All effects as Markdown: `python -m leglab.diagnosis.catalogue > docs/effect_table.md`."""

from itertools import groupby

from leglab.diagnosis.effects import all_effects


def markdown_table() -> str:
    """Names by group with physics, source and the excitation that shows them."""
    lines = [
        "# Effects that the diagnosis can name",
        "",
        "Made by `python -m leglab.diagnosis.catalogue > docs/effect_table.md`.",
    ]
    rows = sorted(all_effects(), key=lambda effect: (effect.group, effect.name, effect.physics))
    for group, effects in groupby(rows, key=lambda effect: effect.group):
        lines += ["", f"## {group}", ""]
        lines += ["| name | physics | shown by | source |", "|---|---|---|---|"]
        for effect in effects:
            cells = (effect.physics, effect.excitation, effect.source)
            text = " | ".join(" ".join(cell.split()).replace("|", "\\|") for cell in cells)
            lines.append(f"| `{effect.name}` | {text} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(markdown_table(), end="")
