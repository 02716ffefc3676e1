"""Output of a diagnosis: diagnosis.json, improved.xml, and tables for the terminal."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from xml.etree import ElementTree

import mujoco
from rich.table import Table

import leglab.machine.plugin
from leglab.base.errors import LeglabError
from leglab.base.output import write_atomically, write_json
from leglab.diagnosis.effects.hypothesis import Hypothesis, Library
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.remainder.part import Part
from leglab.diagnosis.replay.residual import Problem
from leglab.diagnosis.result import Diagnosis, shown_unit
from leglab.machine.mjcf_patch import MjcfPatch, difference_lines, differences

# Number of patching passes: one for changes, one for values that the compiler derives from changes.
_PASSES = 2
# Maximum number of lines of a model difference in the terminal; diagnosis.json has all lines.
_SHOWN = 20


def write_diagnosis(result: Diagnosis, folder: Path) -> Path:
    """Writes DIR/diagnosis.json and returns its path."""
    path = folder / "diagnosis.json"
    write_json(path, result.to_json(), ascii_only=False)
    return path


def write_model(
    problem: Problem, hypothesis: Hypothesis, folder: Path, parts: Sequence[Part] = ()
) -> tuple[Path, tuple[str, ...]]:
    """Writes DIR/improved.xml, the model under a hypothesis with learned parts, and loads it.

    The file's text is patched. If the file is no MJCF, or replicates or attaches changed elements,
    MuJoCo writes a new text instead. Of learned parts, only `parts` are written.

    Returns:
        Path of the file, and its differences from the model, as a unified diff.

    Raises:
        LeglabError: MuJoCo refuses the patched model.
    """
    machine, path = problem.machine, folder / "improved.xml"
    given, spec = machine.spec(whole=True), machine.spec(whole=True)
    own = [plugin.name for plugin in given.plugins]

    def as_written(spec: mujoco.MjSpec) -> str:
        spec.compile()
        return leglab.machine.plugin.to_xml(spec, own)

    change = Library.change(problem.library, hypothesis, machine, written=True)
    for _, edit in change.edits:
        edit(spec)
    plugins = {actuator.name: actuator.plugin for actuator in spec.actuators}
    plugins |= {plugin.name: plugin for plugin in spec.plugins}
    for (element, name), value in change.parameters.items():
        plugins[element].config = {**plugins[element].config, name: repr(value)}
    for part in parts:
        part.write(spec, machine)
    try:
        base, wanted = as_written(given), as_written(spec)
    except (ValueError, mujoco.FatalError) as error:
        raise leglab.machine.plugin.load_error(error, path.name, spec) from error
    place, compiler = machine.path.parent.resolve(), spec.compiler
    files = [*spec.meshes, *spec.hfields, *spec.skins, *spec.textures]
    dirs = {"meshdir": compiler.meshdir, "texturedir": compiler.texturedir}
    dirs = {key: f"{place / name}/" for key, name in dirs.items() if any(f.file for f in files)}
    hinges = {joint.name for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE}

    def written(patch: MjcfPatch) -> tuple[str, tuple[str, ...]]:
        before, after = patch.texts()
        write_atomically(path, lambda stream: stream.write(after.encode()))
        lines = difference_lines(before, after, machine.path.name)
        return as_written(Machine(path).spec(whole=True)), lines

    with suppress(LookupError, ValueError, LeglabError):
        text = machine.path.read_bytes().decode()
        patch, found = MjcfPatch(text, place, dirs, hinges if compiler.degree else ()), base
        for _ in range(_PASSES):
            patch.apply(found, wanted)
            found, lines = written(patch)
            if not any(differences(ElementTree.fromstring(found), ElementTree.fromstring(wanted))):
                return path, lines
    patch = MjcfPatch(base, place, dirs)
    patch.apply(base, wanted)
    return path, written(patch)[1]


def summary_tables(result: Diagnosis) -> list[Table]:
    """Builds tables of verdict, effects and replay errors for the terminal."""
    head = Table(title=f"verdict: {result.verdict}", title_justify="left")
    before = "model" if result.calibration is None else result.nominal_words
    words = (word for e, _ in result.all_effects for word in (e.name, e.element))
    longest = max(map(len, words), default=None)
    for name in ("effect", "parameter", "value", "95 % interval", before):
        wide = longest if name == "effect" else None
        head.add_column(name, no_wrap=name != "effect", min_width=wide)
    for effect, smaller in result.all_effects:
        name = f"{'smaller: ' * smaller}[bold]{effect.name}[/bold] at {effect.element}"
        for p in effect.parameters:
            interval = "{:.4g} … {:.4g}".format(*p.interval)
            value, nominal = f"{p.value:.4g}", f"{p.nominal:.4g}"
            head.add_row(name, f"{p.name} \\[{p.unit}]", value, interval, nominal)
            name = ""
    recalibrated = ("recalibrated",) if result.recalibrated else ()
    columns = ("recording", "before", *recalibrated, "after", "")
    title = "normalised replay error (noise alone gives 1)"
    gaps = Table(*columns, title=title, title_justify="left")
    for row in result.recordings:
        baseline = (row.baseline,) if result.recalibrated else ()
        errors = (f"{error:.2f}" for error in (row.before, *baseline, row.after))
        gaps.add_row(row.name, *errors, "held out" * row.held_out)
    horizon = f"{result.remaining[0].horizon:.3g} s " if result.remaining else ""
    title = f"error {horizon}after a measured start, held-out recordings"
    left = Table(title=title, title_justify="left")
    learned = ["learned"] if any(one.learned is not None for one in result.remaining) else []
    for name in ("measured", "before", "after", *learned, "sensor noise"):
        left.add_column(name, justify="left" if name == "measured" else "right")
    for one in result.remaining:
        factor, unit = shown_unit(one.unit)
        values = (one.before, one.after, one.learned, one.noise)
        left.add_row(one.channel, *(f"{factor * v:.3g} {unit}" for v in values if v is not None))
    return [table for table in (head, left, gaps) if table.row_count]


def summary_lines(result: Diagnosis) -> list[str]:
    """Returns lines for the terminal in addition to the tables: onsets, rivals, balances, notes."""
    lines: list[str] = []
    if len(result.changed) <= _SHOWN:
        lines += result.changed
    if result.learned:
        lines.append(f"learned without a name: {result.learned}")
    if result.calibration is not None:
        before, after = ([row[i] for row in result.calibration.recordings] for i in (1, 2))
        lines.append(
            f"healthy recordings: at most {max(before):.3g} noise levels off by the model as it "
            f"was, {max(after):.3g} by the calibrated specimen"
        )
    for effect in result.effects:
        lines += [f"{effect.name} begins {when}" for when in effect.begins()]
        if effect.indistinguishable_from:
            rivals = ", ".join(effect.indistinguishable_from)
            lines.append(f"{effect.name} is not told apart from {rivals}")
    for where in result.where:
        kind = where.residual if where.residual == "motion" else f"{where.residual} balance"
        region = where.region if where.region.startswith("everywhere") else f"worst {where.region}"
        level = f"{where.level:.3g} noise levels off as it was"
        lines.append(f"{kind} of {where.element}: {level}, {region}")
    if result.next_experiment is not None:
        proposal = result.next_experiment
        lines.append(f"to tell {' from '.join(proposal.rivals)}: {proposal.description}")
    if result.not_testable:
        names = ", ".join(sorted({n.name for n in result.not_testable}))
        lines.append(f"these recordings hardly show: {names}")
    lines += [f"{name} is missing: {reason}" for name, reason in result.missing.items()]
    return [*lines, *(f"note: {note}" for note in result.notes)]
