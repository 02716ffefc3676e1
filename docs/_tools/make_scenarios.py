"""Makes a page a scenario with a clip and a plot: `python docs/_tools/make_scenarios.py`.

Two runs of 20 s each, `static_feedforward` and `bsnn_arx` on the walking leg: a clip of the moment
of the change side by side, the moving error over the whole run, and what the published table says
of the scenario. Pages go to docs/reference/scenarios, pictures to docs/images/scenarios. `--pages`
writes the pages alone, which a test compares with what is there.
"""

import argparse
import io
import tempfile
from pathlib import Path

from make_gallery import write_loop
from PIL import Image

from benchmarks import results
from benchmarks.adaptation_tables import RIG, SHOWN, by_rig, end, text
from leglab import RunSettings, run_scenario, scenario_names
from leglab.base.scenario import get_scenario, scenario_summary
from leglab.cli.catalogue import severity_text
from leglab.report.film import SIZE
from leglab.report.film.workers import draw_frames
from leglab.report.style import SERIES, style
from leglab.runs.folder import read_runs, write_run
from leglab.runs.metrics import sliding_rms

DOCS = Path(__file__).parents[1]

CONTROLLERS = ("static_feedforward", "bsnn_arx")
CLIP_SIZE, CLIP_RATE, CLIP_LENGTH = (480, 270), 5, 3.0  # px, frames a second, s
CLIP_LIMIT = 110_000  # bytes: 20 clips and 20 plots stay below 3 MB

# What happens to the machine, and where it is seen.
LOOK_AT = {
    "air_in_oil": "Air makes the oil in the chambers softer: a pressure follows its valve later. "
    "Little of it reaches the position, with or without learning.",
    "cold_oil": "Oil at 0 °C is many times as thick: viscous friction and leakage change together. "
    "What is left with `bsnn_arx` is left with the `oracle` as well, which was identified on the "
    "cold machine.",
    "cold_start": "Nothing changes at a moment: the oil is cold at the start and warms by its own "
    "losses. The clip shows the first strides, in which `bsnn_arx` learns while the oil thins.",
    "encoder_shift": "The knee's encoder tells another angle than there is. No controller sees "
    "that in the position that it measures: the true error of the knee is the slip, 30 mrad, with "
    "or without learning. A bound for what adapting can do.",
    "external_leak": "Oil leaves both chambers to the outside, in proportion to their pressure. "
    "Look at the feed-forward command after the mark: it gives what leaks.",
    "friction_rise": "Three times the friction of seals and joints: it changes its sign each time "
    "that a joint turns round.",
    "hot_oil": "Thin oil leaks more and rubs less; what it leaks grows with the pressure.",
    "nominal": "The machine as it was built. What is left is noise, resolution and, with "
    "`static_feedforward`, what a calibrated map of steady motion does not hold.",
    "payload": "A mass on the shank: more torque for the same motion, as the colours of the "
    "cylinders (pressure) show.",
    "seal_wear": "Leakage across the pistons takes flow in proportion to the load. Watch the "
    "colour of the cylinders (pressure) and the error, and how `bsnn_arx` has undone "
    "nine tenths of it three seconds later.",
    "seal_wear_supply_drop": "Two faults at once: more flow is lost, and less pressure drives it. "
    "Both make commands grow.",
    "sensor_dropout": "A third of the readings repeat the last one, so measured velocities jump. "
    "The machine is as before: there is nothing to learn, and learning on does no harm.",
    "slow_valve": "Spools that follow with 40 Hz delay every command by some milliseconds, which "
    "a learned map leads by.",
    "spring_fatigue": "The parallel springs carry less of the weight, and the cylinders the rest: "
    "a change of load that depends on the pose alone.",
    "stiction": "Breakaway friction holds a joint where it stands still for a moment, so at each "
    "turn of its motion.",
    "supply_droop": "Faster strides on a pump that gives half its flow: the pressure of the supply "
    "sinks in each stride, and with it what a command gives.",
    "supply_drop": "The pressure of the supply falls to 100 bar: every valve gives less flow for "
    "the same command, so the feed-forward command grows.",
    "valve_null_shift": "All valves are open a little at command 0: a constant is missing from "
    "the command, one number a joint.",
    "valve_wear": "Dead band and hysteresis: near its middle the spool moves and no oil flows. "
    "Hysteresis is no map from motion to command: its part stays, with the `oracle` as well.",
    "viscosity_change": "Oil of another grade: friction and leakage change together, as with "
    "`cold_oil`, but less.",
}


def page(name: str, cells: list[str]) -> str:
    """Markdown of a scenario's page; `cells` are the errors at the end, by `SHOWN`."""
    summary, start = scenario_summary(name), min(get_scenario(name).breakpoints, default=0.0)
    picture = f"../../images/scenarios/{name}"
    when = f"; the machine changes at {start:g} s" if start else ""
    severity = severity_text(name) or "none"
    return f"""---
myst:
  html_meta:
    description: "Scenario {name}: {summary}. Clip, error over time, what to look at"
---
# `{name}`: {summary}

Made by `python docs/_tools/make_scenarios.py`.

![clip of the walking leg with static_feedforward and with bsnn_arx]({picture}.webp)

{LOOK_AT.get(name, "")}

![error of both controllers over the run{when}]({picture}_error.webp)

RMS error of all joints in the last strides of 20 s, in mrad, means over specimens that are 10 %
off the drawing ([all figures](../../results/adaptation_tables.md)); clip and plot are of one run
on the machine as drawn{when}.

| {" | ".join(f"`{controller}`" for controller in SHOWN)} |
|{"---:|" * len(SHOWN)}
| {" | ".join(cells)} |

Size (`--severity`) and its default: {severity}.

```console
leglab run {name} --controller bsnn_arx
leglab report --scenario {name} --controllers static_feedforward,bsnn_arx --out out/{name}
```
"""


def index() -> str:
    """Markdown of the page that lists all scenarios with their pictures."""
    tree = "\n".join(scenario_names())
    pictures = "\n".join(
        f"| [`{name}`]({name}.md) | {scenario_summary(name)} |" for name in scenario_names()
    )
    return f"""# Scenarios

A scenario says what changes on the machine, and when. Each page has a clip of the walking leg, the
error over the run, and what to look at.

Made by `python docs/_tools/make_scenarios.py`.

| scenario | what happens |
|---|---|
{pictures}

```{{toctree}}
:hidden:

{tree}
```
"""


def write_clip(folders: list[Path], start: float, out: Path) -> None:
    """Writes the clip at the best quality that fits into the limit."""
    count = round(CLIP_LENGTH * CLIP_RATE)
    job = {"folders": [str(folder) for folder in folders], "camera": "three_quarter"}
    job |= {"start": start, "last": start + CLIP_LENGTH, "frames": count, "rate": CLIP_RATE}
    drawn = draw_frames(job, backend="egl", count=1)
    frames = [Image.frombytes("RGB", SIZE, frame) for frame in drawn]
    shown = round(1000 / CLIP_RATE)
    write_loop(frames, out, size=CLIP_SIZE, milliseconds=shown, limit=CLIP_LIMIT, best=60)


def write_plot(folders: list[Path], out: Path) -> None:
    """Writes the moving errors of the runs over the whole time."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import LogLocator

    with style():
        figure, axes = plt.subplots(figsize=(6.4, 2.5), layout="constrained")
        for run, color in zip(read_runs(folders), SERIES, strict=False):
            error = run.recording.stack(run.joints, "truth")
            error = error - run.recording.stack(run.joints, "reference")
            moving = 1e3 * sliding_rms(run.recording.time, error, run.configuration.window)
            axes.semilogy(run.recording.time, moving, color=color, label=run.label)
            for change in {c.start for c in run.configuration.changes if c.start > 0}:
                axes.axvline(change, color="0.6", linewidth=0.8)
        axes.set(xlabel="time [s]", ylabel="RMS error over\na stride [mrad]")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.yaxis.set_minor_formatter("")
        figure.legend(loc="outside upper left", ncols=2)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=100)
        plt.close(figure)
    Image.open(buffer).convert("RGB").save(out, "WEBP", quality=80, method=6)


def write_pages(folder: Path) -> None:
    """Writes all pages into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    rigs = by_rig(results.load("adaptation_results"))
    for name in scenario_names():
        cells = [text(end(rigs[RIG], name, controller)) for controller in SHOWN]
        (folder / f"{name}.md").write_text(page(name, cells))
    (folder / "index.md").write_text(index())


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--pages", type=Path, help="write the pages there, and no pictures")
    parser.add_argument("--only", nargs="*", help="pictures of these scenarios alone")
    parser.add_argument("--plots", action="store_true", help="plots alone, and no clips")
    arguments = parser.parse_args()
    write_pages(arguments.pages or DOCS / "reference" / "scenarios")
    if arguments.pages:
        return
    pictures = DOCS / "images" / "scenarios"
    pictures.mkdir(parents=True, exist_ok=True)
    for name in arguments.only or scenario_names():
        with tempfile.TemporaryDirectory() as place:
            folders = []
            for controller in CONTROLLERS:
                run = run_scenario(RunSettings(scenario=name, controller=controller))
                folders.append(write_run(run, Path(place) / controller))
            change = min(get_scenario(name).breakpoints, default=0.0)
            if not arguments.plots:
                write_clip(folders, max(change - 0.7, 0.0), pictures / f"{name}.webp")
            write_plot(folders, pictures / f"{name}_error.webp")


if __name__ == "__main__":
    main()
