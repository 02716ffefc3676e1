"""Edits of an MJCF file as text: unchanged parts keep their order, comments and includes."""

import difflib
import math
import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal, InvalidOperation
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

_TAG = re.compile(
    r"<!--.*?-->|<\?.*?\?>|<!\[CDATA\[.*?\]\]>"
    r"|<(?P<end>/?)(?P<tag>\w+)(?P<rest>(?:\"[^\"]*\"|'[^']*'|[^>\"'])*?)(?P<empty>/?)>",
    re.DOTALL,
)
_ATTRIBUTE = re.compile(r"\s*([\w:]+)\s*=\s*(?:\"([^\"]*)\"|'([^']*)')")
# Attributes that identify an element, in order of preference.
_NAMES = ("name", "key", "instance", "plugin")
# Sections whose elements share one name space, whatever their tags.
_ONE_SPACE = ("actuator", "sensor")
# Attributes that only `general` has; its shortcuts `position` and `velocity` have others instead.
_OF_GENERAL = {"gainprm", "biasprm", "gaintype", "biastype", "dyntype", "dynprm", "input"}
_SAME = 2e-5  # relative tolerance of equal numbers, as MuJoCo writes six digits

# Path from the section down: tag, name, and index among siblings with the same tag and name.
Place = tuple[tuple[str, str, int], ...]
# Path (of the parent if new), element (None: removed), changed attributes (None: new element).
Difference = tuple[Place, ElementTree.Element | None, dict[str, str | None] | None]


class MjcfPatch:
    """An MJCF file and its includes, edited by the differences of two MuJoCo specifications.

    Paths of includes and the asset folders `dirs` (by attribute of `compiler`) become absolute, so
    that the text loads from anywhere. For hinges `in_degrees` the file has `springref` in degrees.
    """

    def __init__(
        self, text: str, folder: Path, dirs: Mapping[str, str], in_degrees: Collection[str] = ()
    ) -> None:
        self._document = _parsed(text, folder)
        (self._root,) = self._document.children
        self._in_degrees = in_degrees
        compilers = [node for node in self._root.inner() if node.tag == "compiler"]
        for node in [n for n in compilers if "dir" in "".join(n.attributes)] or compilers[:1]:
            node.placed = {"assetdir": None, **dirs} if dirs else {}
        if dirs and not compilers:
            self._root.placed_inside = ElementTree.Element("compiler", dict(dirs))

    def apply(self, base: str, wanted: str) -> None:
        """Applies the differences between two specifications, as written by MuJoCo, to the file.

        Raises:
            LookupError: The file lacks an element of the specification: replicated or attached.
        """
        trees = ElementTree.fromstring(base), ElementTree.fromstring(wanted)
        for place, element, changed in differences(*trees):
            nodes = self._found(place)
            if not nodes or (len(nodes) > 1 and (changed is not None or element is None)):
                raise LookupError(place)
            if element is None:
                nodes[0].removed = True
            elif changed is None:
                nodes[-1].added.append(element)
            else:
                self._change(nodes[0], element, changed)

    def texts(self) -> tuple[str, str]:
        """Returns the text before and after the edits, both with the text of changed includes."""
        return self._document.text(before=True), self._document.text()

    def _found(self, place: Place) -> list["_Node"]:
        if not place:
            return [self._root]
        tag, name, _ = place[-1]
        if len(place) == 1:
            return [node for node in self._root.inner() if node.tag == tag]
        parents = self._found(place[:1] if name and tag != "config" else place[:-1])
        everywhere = name and tag not in ("config", *_ONE_SPACE)
        inner = [n for parent in parents for n in parent.inner(everywhere=bool(everywhere))]
        return [n for n in inner if tag in (n.tag, *_ONE_SPACE) and n.name == name]

    def _change(
        self, node: "_Node", element: ElementTree.Element, changed: dict[str, str | None]
    ) -> None:
        spring = changed.get("springref")
        if spring and node.name in self._in_degrees:
            changed["springref"] = f"{math.degrees(float(spring)):.9g}"
        if node.tag == "config" and (value := changed.get("value")):
            changed["value"] = _six_digits(node.attributes.get("value", ""), value)
        if _OF_GENERAL.isdisjoint(changed) or node.tag in ("general", "plugin"):
            node.changed |= changed
            return
        gain = element.get("gainprm", "1").split()[0]
        damping = f"{-float((element.get('biasprm', '') + ' 0 0 0').split()[2]):.9g}"
        if node.tag == "position":
            damped = {"kv": damping, "dampratio": None} if damping != "-0" else {}
            node.changed |= {"kp": gain, **damped}
        elif node.tag == "velocity":
            node.changed |= {"kv": gain}
        else:
            node.tag_after, node.changed = "general", dict.fromkeys(node.attributes)
            node.changed |= element.attrib


def differences(
    base: ElementTree.Element, wanted: ElementTree.Element, place: Place = ()
) -> Iterator[Difference]:
    """Yields the differences of two specifications as MuJoCo writes them, except `compiler`'s."""
    names = {**base.attrib, **wanted.attrib} if base.tag != "compiler" else {}
    changed = {k: wanted.get(k) for k in names if not _same(base.get(k), wanted.get(k))}
    if changed:
        yield place, wanted, changed
    old, new = _by_key(base, place), _by_key(wanted, place)
    for key in {**old, **new}:
        if key not in new:
            yield (*place, key), None, None
        elif key not in old:
            yield place, new[key], None
        else:
            yield from differences(old[key], new[key], (*place, key))


def difference_lines(before: str, after: str, name: str) -> tuple[str, ...]:
    """Returns the unified diff of a file and its improved version, without context lines."""
    texts = before.splitlines(), after.splitlines()
    return tuple(difflib.unified_diff(*texts, name, "improved.xml", n=0, lineterm=""))


def _by_key(
    element: ElementTree.Element, place: Place
) -> dict[tuple[str, str, int], ElementTree.Element]:
    counts: Counter[tuple[str, str]] = Counter()
    found = {}
    one_space = len(place) == 1 and place[0][0] in _ONE_SPACE
    for child in element:
        key = place[0][0] if one_space else child.tag, _name(child.attrib)
        found[*key, counts[key]] = child
        counts[key] += 1
    return found


def _name(attributes: Mapping[str, str]) -> str:
    return next((attributes[key] for key in _NAMES if key in attributes), "")


def _same(old: str | None, new: str | None) -> bool:
    if old == new or old is None or new is None:
        return old == new
    try:
        pairs = [*zip(map(float, old.split()), map(float, new.split()), strict=True)]
    except ValueError:
        return False
    # A vector's rounding is relative to its largest component. A scalar may be as small as 1e-13.
    rounding = _SAME * max((abs(a) for a, _ in pairs), default=0.0) if len(pairs) > 1 else 0.0
    return all(math.isclose(a, b, rel_tol=_SAME, abs_tol=rounding) for a, b in pairs)


def _six_digits(old: str, new: str) -> str:
    """Rounds `new` to six digits towards `old`, to keep bounds; returns non-numbers unchanged."""
    try:
        value = Decimal(new)
        rounding = ROUND_FLOOR if value > Decimal(old or "0") else ROUND_CEILING
    except InvalidOperation:
        return new
    return f"{float(Context(prec=6, rounding=rounding).plus(value)):.6g}"


def _parsed(text: str, folder: Path, file: Path | None = None) -> "_Node":
    """Parses a text and the files it includes into nodes; `file` is the path of an include."""
    document = _Node(text, "", {}, 0, 0)
    document.close = document.stop = len(text)
    stack = [document]
    for match in _TAG.finditer(text):
        if match["end"]:
            node = stack.pop()
            node.close, node.stop = match.span()
        elif match["tag"]:
            pairs = _ATTRIBUTE.finditer(match["rest"])
            given = {one[1]: one[2] if one[2] is not None else one[3] for one in pairs}
            node = _Node(text, match["tag"], given, *match.span())
            stack[-1].children.append(node)
            if not match["empty"]:
                stack.append(node)
            if node.tag == "include":
                path = (folder / given["file"]).resolve()
                if file and not path.is_file():
                    path = (file.parent / given["file"]).resolve()
                node.placed, node.nested = {"file": str(path)}, file is not None
                (node.included,) = _parsed(path.read_bytes().decode(), folder, path).children
    return document


class _Node:
    """An XML element of a file's text, with the edits to make to the element."""

    def __init__(
        self, source: str, tag: str, attributes: dict[str, str], start: int, end: int
    ) -> None:
        self.source, self.tag, self.attributes = source, tag, attributes
        self.start, self.end = start, end  #: of the opening tag
        self.close = self.stop = end  #: start and end of the closing tag; `end` if there is none
        self.children: list[_Node] = []
        self.included: _Node | None = None
        self.nested = False  #: whether it is an include of an included file
        self.placed: dict[str, str | None] = {}
        self.placed_inside: ElementTree.Element | None = None
        self.changed: dict[str, str | None] = {}
        self.added: list[ElementTree.Element] = []
        self.removed, self.tag_after = False, tag

    @property
    def name(self) -> str:
        return _name(self.attributes)

    def inner(self, *, everywhere: bool = False) -> Iterator["_Node"]:
        """Yields the children, or all descendants; included files count as part of this one."""
        for child in self.children:
            if child.included:
                yield from child.included.inner(everywhere=everywhere)
            else:
                yield child
                if everywhere:
                    yield from child.inner(everywhere=True)

    @property
    def _changes(self) -> bool:
        inner = [*self.children, *([self.included] if self.included else [])]
        own = self.changed or self.added or self.removed or self.placed_inside is not None
        placed = self.placed and (self.tag != "include" or self.nested)
        return bool(own or placed) or any(one._changes for one in inner)

    def text(self, *, before: bool = False) -> str:
        """Returns the element's text after all edits, or after edits of paths alone (`before`)."""
        if self.included and self.included._changes:
            return self.included._inside(before).strip()
        if self.removed and not before:
            return ""
        inside = self._inside(before)
        closing = self.source[self.close : self.stop]
        if inside and self.tag and not closing:
            closing = f"</{self.tag}>"
        if not before:
            closing = closing.replace(self.tag, self.tag_after)
        return self._opening(before, inside) + inside + closing

    def _opening(self, before: bool, inside: str) -> str:
        text, changed = self.source[self.start : self.end], {**self.placed}
        if not before:
            changed |= self.changed
            text = re.sub(r"^<\w+", f"<{self.tag_after}", text)
        for key, value in changed.items():
            found = re.search(rf"\s+{key}\s*=\s*(\"[^\"]*\"|'[^']*')", text)
            new = "" if value is None else f" {key}={quoteattr(value)}"
            if found:
                text = text[: found.start()] + new + text[found.end() :]
            elif new:
                end = "/>" if text.endswith("/>") else ">"
                text = text.removesuffix(end).rstrip() + new + end
        return re.sub(r"\s*/>$", ">", text) if inside else text

    def _inside(self, before: bool) -> str:
        text, at = "", self.end
        for child in self.children:
            text += self.source[at : child.start] + child.text(before=before)
            at = child.stop
        text += self.source[at : self.close]
        placed = [] if self.placed_inside is None else [self.placed_inside]
        new: Sequence[ElementTree.Element] = [*placed, *([] if before else self.added)]
        if not new:
            return text
        line = re.search(r"[ \t]*$", self.source[: self.start])
        outer = line[0] if line and self.tag else ""
        step = "  "
        inner = outer + step
        before_first = self.source[: self.children[0].start] if self.children else ""
        if own := re.search(r"\n([ \t]*)$", before_first):
            inner = own[1]
        lines = []
        for element in new:
            ElementTree.indent(element, step)
            told = ElementTree.tostring(element, encoding="unicode").strip().replace(" />", "/>")
            lines += [f"{inner}{line}" for line in told.splitlines()]
        return text.rstrip() + "\n" + "\n".join(lines) + "\n" + outer
