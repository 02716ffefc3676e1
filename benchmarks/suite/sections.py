"""A page of sections with tables, some of them folded: one file that runs no script."""

from collections.abc import Sequence
from dataclasses import dataclass

from leglab.report.page.shell import Table, render


@dataclass(frozen=True, kw_only=True)
class Group:
    """A section of the page."""

    name: str  #: For links within the page
    title: str  #: Its heading
    tables: Sequence[Table] = ()  #: What is seen at once; those without rows are left out
    text: str = ""  #: A sentence or two above them
    #: What can be opened: title, text, tables.
    folds: Sequence[tuple[str, str, Sequence[Table]]] = ()


def tables_page(kind: str, title: str, headline: str, sections: Sequence[Group]) -> str:
    """Returns the page.

    Args:
        kind: What makes it, for its head.
        title: Of the page.
        headline: Its first sentence.
        sections: In their order.
    """
    links = [(section.name, section.title) for section in sections]
    return render(
        "tables.html", kind=kind, title=title, headline=headline, sections=sections, links=links
    )
