"""The folders, the public names and the page that says where things are."""

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import leglab

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "leglab"


@pytest.mark.parametrize("name", leglab.__all__)
def test_a_public_name_is_there(name):
    assert getattr(leglab, name) is not None


def test_an_unknown_name_is_refused():
    with pytest.raises(AttributeError, match="No leglab attribute run_scenarios"):
        _ = leglab.run_scenarios


def test_importing_the_package_loads_nothing_heavy():
    code = "import sys, leglab; print(*{'mujoco', 'numpy', 'pydantic', 'scipy'} & {*sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_no_module_lies_loose_at_the_root():
    assert {path.name for path in PACKAGE.glob("*.py*")} - {"py.typed"} == {
        "__init__.py",
        "__init__.pyi",
        "__main__.py",
    }


def test_at_most_eight_layers_hold_every_folder():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = next(c["layers"] for c in contracts["contracts"] if c["type"] == "layers")
    assert len(layers) <= 8
    named = {part.strip().removeprefix("leglab.") for layer in layers for part in layer.split("|")}
    folders = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()}
    # Models are data, and the compiled core is below everything.
    assert folders - {"models", "_native"} == named


def test_only_package_faces_re_export():
    for path in PACKAGE.rglob("*.py"):
        body = ast.parse(path.read_text()).body
        own = [
            node for node in body if not isinstance(node, ast.Import | ast.ImportFrom | ast.Expr)
        ]
        assert path.name in ("__init__.py", "__main__.py") or own, f"{path} only re-exports"


def test_the_places_that_contributing_names_exist():
    text = (ROOT / "docs" / "development" / "contributing.md").read_text()
    found = text[text.index("## Find a room") : text.index("## Words")]
    places = set(re.findall(r"`([\w./]+/[\w./]*)`", found)) - {"benchmarks/NAME.py"}
    assert len(places) > 40
    for place in places:
        name = place.replace("NAME", "nominal").removeprefix("leglab/").rstrip("/")
        bases = (PACKAGE, ROOT, PACKAGE / "csrc")
        known = [base / f"{name}{end}" for base in bases for end in ("", ".py")]
        assert any(path.exists() for path in known), f"contributing.md names {place}"
