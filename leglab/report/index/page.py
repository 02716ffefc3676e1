"""The index as a page with a filter and columns to sort by."""

from pathlib import Path

from leglab.base.errors import LeglabError
from leglab.data import write_atomically
from leglab.report.index.entries import Entry, find_entries
from leglab.report.page.shell import asset, render

_HEAD = (
    "where",
    "kind",
    "scenario",
    "controller",
    "model",
    "seed",
    "RMS before [mrad]",
    "RMS after [mrad]",
    "outcome",
    "written, UTC",
)
_NUMBERS = ("seed", "RMS before [mrad]", "RMS after [mrad]")
_OURS = '<meta name="generator" content="leglab index"'


def write_index(folder: Path, path: Path) -> tuple[list[Entry], Path]:
    """Writes the index of a folder.

    Args:
        folder: Below which to look.
        path: The page; an earlier index is replaced, another file is not.

    Returns:
        What was found, and the path.

    Raises:
        LeglabError: There is no such folder, the path holds a file that is no index, or it cannot
            be written.
    """
    if path.is_dir():
        raise LeglabError(f"{str(path)!r} is a folder; give the name of a page")
    try:
        earlier = path.read_text(encoding="utf-8", errors="replace") if path.exists() else None
    except OSError as error:
        raise LeglabError(f"{path}: cannot be read: {error.strerror}") from error
    if earlier is not None and _OURS not in earlier:
        raise LeglabError(f"{str(path)!r} is no index of leglab: it is left as it is")
    entries = find_entries(folder, path.parent)
    text = page(entries, folder.resolve().name)
    write_atomically(path, lambda stream: stream.write(text.encode(errors="replace")))
    return entries, path


def page(entries: list[Entry], name: str) -> str:
    """The page.

    Args:
        entries: What was found.
        name: Of the folder.
    """
    counts: dict[str, int] = {}
    for entry in entries:
        counts[entry.kind] = counts.get(entry.kind, 0) + 1
    parts = [f"{count} {kind}{'s' * (count > 1)}" for kind, count in sorted(counts.items())]
    summary = ", ".join(parts).replace("diagnosiss", "diagnoses") or "Nothing was found"
    for state, told in (("stopped", "stopped half way"), ("broken", "cannot be read")):
        count = sum(entry.state == state for entry in entries)
        summary += f"; {count} {told}" if count else ""
    return render(
        "index.html",
        kind="index",
        scripts=(asset("index.js"),),
        title=f"Runs below {name}",
        summary=f"{summary}.",
        head=_HEAD,
        numbers=_NUMBERS,
        entries=entries,
    )
