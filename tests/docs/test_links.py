"""The built documentation: its links, and what it tells search engines and readers of itself."""

import importlib.util
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest

from leglab import scenario_names

DOCS = Path(__file__).parents[2] / "docs"
SCRIPT, CONF = DOCS / "_tools" / "check_links.py", DOCS / "conf.py"


def loaded(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


check_links = loaded(SCRIPT)


def site(folder, **links):
    (folder / "sub").mkdir()
    (folder / "a b.png").write_bytes(b"")
    (folder / "sub" / "index.html").write_text('<h1 id="top">x</h1><a name="old">y</a>')
    body = "".join(f'<a href="{link}">{name}</a>' for name, link in links.items())
    (folder / "index.html").write_text(f'<p id="here">{body}<img src="a%20b.png"/></p>')
    return folder


GOOD = {
    "own": "#here",
    "part": "sub/index.html#top",
    "anchor": "sub/#old",
    "rooted": "/sub/index.html",
    "outside": "https://example.org/nothing#x",
    "mail": "mailto:a@example.org",
}


def test_links_that_lead_somewhere_are_no_news(tmp_path):
    assert check_links.broken_links(site(tmp_path, **GOOD)) == []


def test_a_link_that_leads_nowhere_is_named(tmp_path):
    bad = {
        "page": "gone.html",
        "part": "sub/index.html#gone",
        "own": "#gone",
        "beyond": "../outside.html",
        "picture": "gone.png",
    }
    (tmp_path / "outside.html").write_text("")
    folder = tmp_path / "site"
    folder.mkdir()
    found = check_links.broken_links(site(folder, **GOOD, **{f"bad{k}": v for k, v in bad.items()}))
    assert [line.split(": ")[1] for line in found] == list(bad.values())
    assert "index.html has no such part" in found[1]


@pytest.mark.parametrize(
    ("address", "known"),
    [("https://example.org/leglab", True), ("https://example.org/leglab/", True), ("", False)],
)
def test_a_site_with_an_address_lists_its_pages(tmp_path, monkeypatch, address, known):
    monkeypatch.setenv("LEGLAB_DOCS_URL", address)
    conf = loaded(CONF)
    app = SimpleNamespace(
        config=SimpleNamespace(html_baseurl=conf.html_baseurl),
        builder=SimpleNamespace(name="html"),
        env=SimpleNamespace(found_docs={"index", "guides/model"}),
        outdir=tmp_path,
    )
    conf._write_sitemap(app, None)
    assert (tmp_path / "sitemap.xml").exists() is known
    if known:
        found = ElementTree.parse(tmp_path / "sitemap.xml").getroot()
        assert [page.text for page in found.iter(f"{found.tag.removesuffix('urlset')}loc")] == [
            "https://example.org/leglab/guides/model.html",
            "https://example.org/leglab/index.html",
        ]


def test_the_site_says_its_version_and_commit():
    describe = ["git", "describe", "--tags", "--always", "--dirty=+"]
    git = subprocess.run(describe, cwd=SCRIPT.parent, capture_output=True, text=True, check=False)
    told = f" ({git.stdout.strip()})" if git.returncode == 0 else ""
    assert loaded(CONF).html_title == f"leglab {metadata.version('leglab')}{told}"


@pytest.mark.slow("our own figures")
def test_pages_of_the_gallery_are_what_their_script_writes(tmp_path):
    command = [sys.executable, str(SCRIPT.with_name("make_scenarios.py")), "--pages", str(tmp_path)]
    subprocess.run(command, check=True)
    made = {path.name: path.read_text() for path in tmp_path.iterdir()}
    assert made == {
        path.name: path.read_text() for path in (DOCS / "reference" / "scenarios").iterdir()
    }
    assert set(made) == {f"{name}.md" for name in (*scenario_names(), "index")}
    pictures = list((DOCS / "images" / "scenarios").iterdir())
    shown = {f"{name}{end}.webp" for name in scenario_names() for end in ("", "_error")}
    assert {path.name for path in pictures} == shown
    assert sum(path.stat().st_size for path in pictures) < 3_000_000
