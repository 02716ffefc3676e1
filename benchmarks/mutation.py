"""Faults put into the code one by one, and the tests that notice: `python benchmarks/mutation.py`.

A mutant has one operator, number or comparison of a module changed. Each runs in a process of its
own, forked when packages are loaded, with the tests named here, until the first one fails or some
minutes are over. What no test notices is printed with its line.
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
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import results

ROOT = Path(__file__).parents[1]
_VERDICT = ("tests/test_diagnosis_parts.py", "tests/test_diagnosis_verdicts.py")
MODULES = {
    "leglab.runs.metrics": ("tests/test_metrics.py",),
    "leglab.runs.clock": ("tests/test_clock.py",),
    "leglab.diagnosis.likelihood.evidence": _VERDICT,
    "leglab.diagnosis.likelihood.priors": _VERDICT,
    "leglab.diagnosis.verdict.confidence": _VERDICT,
    "leglab.diagnosis.verdict.verdict": _VERDICT,
}
PATIENCE = 400.0  # s
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
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        yield lambda n: setattr(n, "op", ast.UAdd() if isinstance(n.op, ast.USub) else _Truth())
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        yield lambda n: setattr(n, "value", n.value + 1)
    elif isinstance(node, ast.Call):
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        key = "attr" if isinstance(node.func, ast.Attribute) else "id"
        if name in _CALLS:
            yield lambda n, key=key, name=name: setattr(n.func, key, _CALLS[name])


class _Truth(ast.Not):
    """Stands for "not not", which `ast.unparse` writes as "not" and a pass below takes away."""


class _WithoutNot(ast.NodeTransformer):
    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        self.generic_visit(node)
        return node.operand if isinstance(node.op, _Truth) else node


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
            other = ast.fix_missing_locations(_WithoutNot().visit(other))
            after = ast.unparse(_WithoutNot().visit(target))
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


def _tested(mutant: importlib.abc.MetaPathFinder, tests: tuple[str, ...]) -> None:
    """Runs the tests with a changed module, and ends the process with their status."""
    sink = os.open(os.devnull, os.O_WRONLY)
    os.dup2(sink, 1)
    os.dup2(sink, 2)
    os.chdir(ROOT)
    sys.meta_path.insert(0, mutant)
    if native := sys.modules.get("leglab._native"):
        importlib.import_module("leglab")._native = native
    arguments = ["-x", "-q", "-o", "cache_dir=.pytest_cache/mutants", "-p", "no:randomly", *tests]
    os._exit(int(pytest.main(arguments)))


def survives(mutant: importlib.abc.MetaPathFinder, tests: tuple[str, ...]) -> bool:
    """Whether all tests pass with a module that is changed, which the mutant gives to Python."""
    process = multiprocessing.get_context("fork").Process(target=_tested, args=(mutant, tests))
    process.start()
    process.join(PATIENCE)
    if process.is_alive():
        process.kill()
        process.join()
    return process.exitcode == 0


def _load_packages(tests: tuple[str, ...]) -> None:
    """Loads what the tests import, and forgets our own modules, so that each child imports them."""
    sys.path.insert(0, str(ROOT))
    for test in tests:
        importlib.import_module(test.removesuffix(".py").replace("/", "."))
    ours = [n for n in sys.modules if n.split(".")[0] in ("leglab", "tests")]
    for name in ours:
        if not name.startswith("leglab._native"):  # Python loads a compiled module once.
            del sys.modules[name]


def measure(options: argparse.Namespace) -> dict[str, dict]:
    """Numbers of mutants made and noticed, and what survived, by module."""
    found = {}
    for name in options.modules or MODULES:
        tests = (*MODULES[name], *(("-m", "not slow") if options.quick else ()))
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


def main() -> None:
    """Measures, or prints what is kept."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("modules", nargs="*", help="allowed: " + ", ".join(MODULES))
    parser.add_argument("--most", type=int, default=10_000, help="mutants of a module, by chance")
    parser.add_argument("--quick", action="store_true", help="by the tests of `make test` alone")
    results.main(parser, measure, tables)


if __name__ == "__main__":
    main()
