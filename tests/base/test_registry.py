import sys

import pytest

from leglab.base.errors import LeglabError
from leglab.base.registry import Registry, import_modules


def build():
    return 1


def other():
    return 2


def test_entries_by_name():
    registry = Registry("thing")
    registry.add("b", build, build)
    registry.add("a", other, other)
    assert registry.names() == ("a", "b")
    assert registry.get("a") is other


def test_same_definition_may_come_twice_another_may_not():
    registry = Registry("thing")
    registry.add("a", build, build)
    registry.add("a", build, build)
    with pytest.raises(LeglabError, match=r"thing 'a' is defined twice: in .*test_registry.py"):
        registry.add("a", other, other)


def test_loaders_run_once_at_the_first_look_up():
    registry = Registry("thing")
    calls = []
    registry.add_loader(lambda: (calls.append(1), registry.add("a", build, build)))
    assert calls == []
    assert registry.names() == ("a",)
    registry.get("a")
    assert calls == [1]


def test_imports_public_modules_only(tmp_path, monkeypatch):
    package = tmp_path / "some_package"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "public.py").write_text("")
    (package / "_private.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    import_modules("some_package", [str(package)])
    assert "some_package.public" in sys.modules
    assert "some_package._private" not in sys.modules
