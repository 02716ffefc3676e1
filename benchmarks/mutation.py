"""Faults put into the code one by one, and the tests that notice.

A mutant has one operator, number or comparison of a module changed. Each runs in a process of its
own, forked when packages are loaded, with the tests named here, until the first one fails or some
minutes are over. What no test notices is printed with its line.

`--faults` puts in the faults of judging that stand here, each with the test of `make test` that
looks for it, prints what turns red, and fails if a test stays green.
"""

import argparse
import ast
import copy
import importlib.abc
import importlib.util
import multiprocessing
import os
import random
import sys
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from benchmarks import results

ROOT = Path(__file__).parents[1]
_VERDICT = ("tests/diagnosis/test_parts.py", "tests/diagnosis/test_verdicts.py")
_JUDGING = ("tests/diagnosis/test_judging.py",)
_MAKE_TEST = ("-m", "not slow and not soak")
MODULES = {
    "leglab.runs.metrics": ("tests/runs/test_metrics.py",),
    "leglab.runs.clock": ("tests/runs/test_clock.py",),
    "leglab.diagnosis.likelihood.evidence": _VERDICT,
    "leglab.diagnosis.likelihood.priors": _VERDICT,
    "leglab.diagnosis.verdict.confidence": _JUDGING,
    "leglab.diagnosis.verdict.table": _JUDGING,
    "leglab.diagnosis.verdict.tabulation": _VERDICT,
    "leglab.diagnosis.verdict.outcome": _VERDICT,
    "leglab.diagnosis.verdict.verdict": _VERDICT,
}
PATIENCE = 400.0  # s
# Faults of judging: the module of leglab, its text, what is put in its place, and the test of
# `make test` that must turn red.
FAULTS = {
    "a name is sure whatever is left": (
        "diagnosis.verdict.confidence", "return float(odds / (1.0 + odds))", "return 1.0",
        "test_a_cause_that_no_effect_describes_gives_no_sure_name",
    ),
    "rivals that fit as well are no ties": (
        "diagnosis.verdict.confidence",
        "_ties(table, sets[best[0]], next(iter(names))) if alone else ()", "()",
        "test_a_rival_that_fits_as_well_halves_the_confidence_of_a_gain",
    ),
    "a name may lack a part of the recordings": (
        "diagnosis.verdict.confidence",
        "float(share[sound].sum()), float(parts[sound].sum(axis=0).min())",
        "(float(share[sound].sum()),)", "test_what_a_single_recording_shows_has_no_name",
    ),
    "directions need not differ": (
        "diagnosis.verdict.tabulation", "return max(claims, default=1.0)", "return 1.0",
        "test_friction_by_direction_is_named_only_where_directions_differ",
    ),
    "what ended at a bound has a name": (
        "diagnosis.verdict.confidence",
        "sound = has & ~np.array([bool(one.ended) for one in sets])", "sound = has",
        "test_what_ends_at_its_bound_has_no_name",
    ),
    "all is clear at any error": (
        "diagnosis.replay.residual", "return largest**0.5 <= EXPLAINED", "return True",
        "test_nothing_is_named_where_nothing_that_is_looked_for_is_there",
    ),
    "all is clear though another set is more probable": (
        "diagnosis.verdict.confidence", "if not one.keys and probable and one.quiet:",
        "if not one.keys and one.quiet:",
        "test_what_explains_the_recordings_as_well_stands_beside",
    ),
    "a healthy machine is not all-clear": (
        "diagnosis.search.healthy",
        "return bool(np.median(ratio) <= limits[0] and largest <= limits[1])",
        "return False",
        "test_a_machine_that_errs_as_it_did_lacks_nothing",
    ),
    "a machine that errs as it did has changed where a set gains": (
        "diagnosis.verdict.confidence",
        "as_it_was = bool(table.as_it_was) or (table.as_it_was is not None and quiet is not None)",
        "as_it_was = False",
        "test_an_unchanged_machine_is_told_so_whatever_explains_its_errors",
    ),
    "a drive may be turned down": (
        "diagnosis.verdict.sets", "return np.where(blown, lost.min(), lost)", "return 0.0 * lost",
        "test_a_set_that_turns_the_drive_down_loses_in_units_of_the_drive",
    ),
    "what hardly acts where held out is refuted": (
        "diagnosis.verdict.table", "share -= acts * max(share - explains, 0.0)",
        "share = min(share, explains)",
        "test_what_held_out_motion_hardly_shows_is_told_by_all_recordings",
    ),
    "a name stands while most is left": (
        "diagnosis.verdict.verdict",
        'if verdict in ("named", "confusion_set") and explained < EXPLANATION:',
        "if False:", "test_nothing_is_named_where_nothing_that_is_looked_for_is_there",
    ),
    "intervals are a fifth as wide": (
        "diagnosis.verdict.verdict", "half = np.hypot(", "half = 0.2 * np.hypot(",
        "test_intervals_hold_the_truth_whatever_the_noise",
    ),
    "what was so before is part of the gap": (
        "diagnosis.verdict.outcome",
        "return self.specimen.levels[nearest[problem.replay.recording], 1] ** 2",
        "return np.ones(problem.replay.windows)",
        "test_a_machine_that_errs_as_it_did_lacks_nothing",
    ),
    "the gap is that of fitted recordings": (
        "diagnosis.replay.residual", "return self.held if self.held.any() else self.fitted",
        "return self.fitted", "test_shares_intervals_and_gaps_agree_with_each_other",
    ),
    "held-out recordings are fitted": (
        "diagnosis.search.search", "looked_at = problem.fitted",
        "looked_at = problem.fitted | problem.held", "test_held_out_recordings_are_not_fitted",
    ),
    "an onset is told late": (
        "diagnosis.search.onset", "ends[i] = min(seen, last + length), seen",
        "ends[i] = seen + 0.3, seen + 0.3",
        "test_what_begins_during_a_recording_is_told_with_its_time",
    ),
    "every machine is exact": (
        "diagnosis.likelihood.evidence",
        "self.places = tuple(range(len(priors.sizes)) if places is None else places)",
        "self.places = (0,) if places is None else tuple(places)",
        "test_a_command_that_moved_nothing_is_no_weak_drive",
    ),
    "neighbouring errors are independent": (
        "diagnosis.likelihood.evidence",
        "return float((z**2).sum() * count / (count - 1) / keep.sum())", "return 1.0",
        "test_errors_of_a_rough_machine_are_worth_fewer_numbers_than_they_are",
    ),
    "improved.xml carries what has no name": (
        "diagnosis.improve", 'told if result.verdict == "named" else ()', "told",
        "test_the_improved_model_carries_no_effect_without_a_name",
    ),
    "any name in doubt is doubt": (
        "benchmarks.self_test.exact", "return not self.named or max(self.confidence) <= _DOUBT",
        'return not self.named or self.verdict != "named"',
        "test_a_wrong_name_given_with_confidence_is_no_doubt",
    ),
}  # fmt: skip
_COMPARISONS = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
_OPERATORS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip
_CALLS = {"max": "min", "min": "max", "any": "all", "all": "any", "maximum": "minimum"}


def changes(node: ast.AST) -> Iterator[Callable[[ast.AST], None]]:
    """Yields functions that change a node of this kind in place."""
    if isinstance(node, ast.Compare):
        for i, operator in enumerate(node.ops):
            other = _COMPARISONS[type(operator)]
            yield lambda n, i=i, other=other: n.ops.__setitem__(i, other())
    elif isinstance(node, ast.BinOp | ast.BoolOp | ast.AugAssign) and type(node.op) in _OPERATORS:
        other = _OPERATORS[type(node.op)]
        yield lambda n, other=other: setattr(n, "op", other())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        yield lambda n: setattr(n, "op", ast.UAdd())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield lambda n: setattr(n, "operand", ast.UnaryOp(ast.Not(), n.operand))
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        yield lambda n: setattr(n, "value", n.value + 1)
    elif isinstance(node, ast.Call):
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        key = "attr" if isinstance(node.func, ast.Attribute) else "id"
        if name in _CALLS:
            yield lambda n, key=key, name=name: setattr(n.func, key, _CALLS[name])


def mutants(source: str) -> list[tuple[str, str]]:
    """Returns line and change of every mutant, and its source; docstrings and types stay."""
    tree, found = ast.parse(source), []
    skipped = {
        id(inner)
        for node in ast.walk(tree)
        for part in (getattr(node, "annotation", None), getattr(node, "returns", None))
        if part is not None
        for inner in ast.walk(part)
    }
    for place, node in enumerate(ast.walk(tree)):
        if id(node) in skipped:
            continue
        for which, _ in enumerate(changes(node)):
            other = copy.deepcopy(tree)
            target = next(n for i, n in enumerate(ast.walk(other)) if i == place)
            before = ast.unparse(target)
            list(changes(target))[which](target)
            after = ast.unparse(target)
            found.append((f"line {node.lineno}: {before} -> {after}", ast.unparse(other)))
    return found


class _Mutant(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Gives Python the changed source of one module."""

    def __init__(self, name: str, path: str, source: str) -> None:
        self._name, self._path, self._source = name, path, source

    def find_spec(self, name, path=None, target=None):
        if name == self._name:
            return importlib.util.spec_from_file_location(name, self._path, loader=self)
        return None

    def exec_module(self, module):
        exec(compile(self._source, self._path, "exec"), module.__dict__)


class _FirstRed:
    """Sends the name of what fails, or cannot be collected, to another process."""

    def __init__(self, told: Connection) -> None:
        self._told = told

    def pytest_runtest_logreport(self, report):
        if report.failed:
            self._told.send(report.nodeid)

    pytest_collectreport = pytest_runtest_logreport


def _tested(mutant: importlib.abc.MetaPathFinder, tests: tuple[str, ...], told: Connection) -> None:
    """Runs the tests with a changed module, and tells which one fails first, or that none does."""
    sink = os.open(os.devnull, os.O_WRONLY)
    os.dup2(sink, 1)
    os.dup2(sink, 2)
    os.chdir(ROOT)
    sys.meta_path.insert(0, mutant)
    if native := sys.modules.get("leglab._native"):
        importlib.import_module("leglab")._native = native
    arguments = ["-x", "-q", "-o", "cache_dir=.pytest_cache/mutants", "-p", "no:randomly", *tests]
    if pytest.main(arguments, plugins=[_FirstRed(told)]) == pytest.ExitCode.OK:
        told.send("")
    os._exit(0)


def first_red(mutant: importlib.abc.MetaPathFinder, tests: tuple[str, ...]) -> str | None:
    """The first test that fails with a module that is changed, which the mutant gives to Python.

    Empty where all pass; None where the tests came to no end.
    """
    context = multiprocessing.get_context("fork")
    heard, told = context.Pipe(duplex=False)
    process = context.Process(target=_tested, args=(mutant, tests, told))
    process.start()
    told.close()
    try:
        return str(heard.recv()) if heard.poll(PATIENCE) else None
    except EOFError:
        return None
    finally:
        process.kill()
        process.join()


def survives(mutant: importlib.abc.MetaPathFinder, tests: tuple[str, ...]) -> bool:
    """Whether all tests pass with a module that is changed."""
    return first_red(mutant, tests) == ""


def _load_packages(tests: tuple[str, ...]) -> None:
    """Loads what the tests import, and forgets our own modules, so that each child imports them."""
    sys.path.insert(0, str(ROOT))
    for test in tests:
        importlib.import_module(test.removesuffix(".py").replace("/", "."))
    own = ("leglab", "tests", "rigs", "benchmarks", "replication")
    for name in [n for n in sys.modules if n.split(".")[0] in own]:
        if "._native" not in name:  # Python loads a compiled module once.
            del sys.modules[name]


def put_in_faults(some: Sequence[str]) -> bool:
    """Puts in the faults of judging, or those named, and tells whether all turn their test red."""
    tests = *_VERDICT, *_JUDGING
    _load_packages(tests)
    noticed = True
    for name in some or FAULTS:
        short, old, new, test = FAULTS[name]
        module = short if short.startswith("benchmarks.") else f"leglab.{short}"
        path = ROOT / (module.replace(".", "/") + ".py")
        source, red = path.read_text(), None
        if source.count(old) == 1:
            mutant = _Mutant(module, str(path), source.replace(old, new))
            red = first_red(mutant, (*tests, *_MAKE_TEST, "-k", test))
        told = red or ("GREEN" if red == "" else "NOT TRIED: no such text or test, or no end")
        print(f"{name}: {told}", flush=True)
        noticed = noticed and bool(red)
    return noticed


def measure(options: argparse.Namespace) -> dict[str, dict] | None:
    """Numbers of mutants made and noticed, and what survived, by module."""
    if options.faults is not None:
        sys.exit(0 if put_in_faults(options.faults) else 1)
    found = {}
    for name in options.modules or MODULES:
        tests = (*MODULES[name], *(_MAKE_TEST if options.quick else ()))
        path = str(ROOT / (name.replace(".", "/") + ".py"))
        every = mutants(Path(path).read_text())
        some = random.Random(0).sample(every, min(options.most, len(every)))
        _load_packages(MODULES[name])
        if not survives(_Mutant(name, path, Path(path).read_text()), tests):
            sys.exit(f"the tests of {name} fail without a fault")
        left = []
        for told, source in some:
            if survives(_Mutant(name, path, source), tests):
                left.append(told)
                print(f"{name} {told}", flush=True)
        found[name] = {"all": len(every), "tried": len(some), "survived": left}
        print(f"{name}: {len(some) - len(left)} of {len(some)} noticed", flush=True)
    return found


def tables(kept: dict[str, dict]) -> str:
    """A row a module."""
    head = ["", "mutants", "tried", "noticed", "share"]
    return results.table(
        head,
        [
            (
                f"`{name}`",
                str(row["all"]),
                str(row["tried"]),
                str(row["tried"] - len(row["survived"])),
                f"{100 * (1 - len(row['survived']) / row['tried']):.0f} %",
            )
            for name, row in kept.items()
        ],
    )


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("modules", nargs="*", help="allowed: " + ", ".join(MODULES))
    parser.add_argument("--most", type=int, default=10_000, help="mutants of a module, by chance")
    parser.add_argument("--quick", action="store_true", help="by the tests of `make test` alone")
    parser.add_argument(
        "--faults",
        nargs="*",
        choices=FAULTS,
        metavar="FAULT",
        help="put in the faults of judging, all or some",
    )
