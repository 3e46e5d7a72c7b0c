"""Reads a page as a tree, as far as tests look into it."""

from collections.abc import Iterator
from html.parser import HTMLParser

VOID = {"br", "col", "hr", "img", "input", "link", "meta", "source"}


class Node:
    """One element: its tag, attributes, and what stands in it."""

    def __init__(self, tag: str, attributes: dict[str, str]) -> None:
        self.tag = tag
        self.attributes = attributes
        self.inside: list[Node | str] = []

    def __getitem__(self, attribute: str) -> str:
        return self.attributes.get(attribute, "")

    @property
    def classes(self) -> set[str]:
        return set(self["class"].split())

    @property
    def text(self) -> str:
        """All text in it, with single spaces."""
        return " ".join("".join(self._texts()).split())

    def _texts(self) -> Iterator[str]:
        for part in self.inside:
            yield from (part,) if isinstance(part, str) else (" ", *part._texts(), " ")

    def all(self, tag: str = "", cls: str = "", **attributes: str) -> list["Node"]:
        """Every element in it with this tag, class and these attributes, in order."""
        return [
            node
            for node in self._nodes()
            if tag in ("", node.tag)
            and (not cls or cls in node.classes)
            and all(node[key] == value for key, value in attributes.items())
        ]

    def one(self, tag: str = "", cls: str = "", **attributes: str) -> "Node":
        (found,) = self.all(tag, cls, **attributes)
        return found

    def _nodes(self) -> Iterator["Node"]:
        for part in self.inside:
            if isinstance(part, Node):
                yield part
                yield from part._nodes()


class _Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.open = [Node("", {})]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        node = Node(tag, {key: value or "" for key, value in attrs})
        self.open[-1].inside.append(node)
        if tag not in VOID:
            self.open.append(node)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.open[-1].inside.append(Node(tag, {key: value or "" for key, value in attrs}))

    def handle_endtag(self, tag: str) -> None:
        while self.open[-1].tag != tag:
            self.open.pop()
        self.open.pop()

    def handle_data(self, data: str) -> None:
        self.open[-1].inside.append(data)


def read(text: str) -> Node:
    """Read HTML or SVG."""
    reader = _Reader()
    reader.feed(text)
    return reader.open[0]
