"""Checks the links within a built site: `python docs/_tools/check_links.py out/docs`.

Every `href` and `src` of every page that names a file of the site must name one that is there, and
every `#part` a part of that page. Addresses of other hosts are not asked.
"""

import sys
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class _Page(HTMLParser):
    """Links and parts of a page.

    Attributes:
        links: Values of `href` and `src`.
        parts: Values of `id`, and of `name` of anchors.
    """

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.parts: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if value is None:
                continue
            if name in ("href", "src") and tag != "base":
                self.links.append(value)
            elif name == "id" or (name == "name" and tag == "a"):
                self.parts.add(value)

    handle_startendtag = handle_starttag


@cache
def _read(path: Path) -> _Page:
    return _Page(path.read_text(encoding="utf-8"))


def broken_links(site: Path) -> list[str]:
    """Returns a line for each link of a site that leads nowhere: page, link and what is missing.

    Args:
        site: Folder of the pages.
    """
    site, found = site.resolve(), []
    for page in sorted(site.rglob("*.html")):
        for link in dict.fromkeys(_read(page).links):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            path = unquote(parts.path)
            aim = site / path.lstrip("/") if path.startswith("/") else page.parent / path
            aim = (aim if path else page).resolve()
            if aim.is_dir():
                aim /= "index.html"
            name = page.relative_to(site)
            if not aim.is_relative_to(site) or not aim.is_file():
                found.append(f"{name}: {link}: there is no such file in the site")
                continue
            asked = unquote(parts.fragment) if aim.suffix == ".html" else ""
            if asked and asked not in _read(aim).parts:
                found.append(f"{name}: {link}: {aim.name} has no such part")
    return found


def main() -> None:
    """Command line; exits with 1 where a link is broken."""
    if len(sys.argv) != 2 or not (Path(sys.argv[1]) / "index.html").is_file():
        raise SystemExit(
            "usage: python docs/_tools/check_links.py FOLDER, with an index.html in it"
        )
    site = Path(sys.argv[1])
    broken = broken_links(site)
    for line in broken:
        print(line, file=sys.stderr)
    count = len(list(site.rglob("*.html")))
    print(f"{count} pages, {len(broken)} broken links")
    raise SystemExit(bool(broken))


if __name__ == "__main__":
    main()
