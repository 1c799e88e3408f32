"""Text that others wrote – a drive, a file, a link – as it may be shown.

Nothing in it acts on a terminal.
"""

from __future__ import annotations

import unicodedata
from typing import Any

__all__ = ["harmless_cell", "plain", "plain_lines", "plain_tree"]

_ACT = {
    "Cc",
    "Cf",
    "Cs",
    "Co",
    "Cn",
    "Zl",
    "Zp",
}  # control, format (bidi), surrogate, …, separators


def plain(text: str) -> str:
    """One line: what a terminal or an editor would act on stands there as an escape."""
    if text.isprintable():
        return text
    return "".join(_shown(c) if unicodedata.category(c) in _ACT else c for c in text)


def plain_lines(text: str) -> str:
    """A text of several lines, made harmless; tabs stay, too."""
    return "\n".join("\t".join(map(plain, line.split("\t"))) for line in text.split("\n"))


def plain_tree(tree: Any) -> Any:
    """A tree of JSON with each text of it as one plain line."""
    if isinstance(tree, str):
        return plain(tree)
    if isinstance(tree, list):
        return [plain_tree(item) for item in tree]
    if isinstance(tree, dict):
        return {plain_tree(key): plain_tree(item) for key, item in tree.items()}
    return tree


def _shown(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")


def harmless_cell(text: str) -> str:
    """A text that no spreadsheet takes for a formula; numbers are as they are."""
    found = plain(text)
    if found[:1] not in ("=", "+", "-", "@", "\t"):
        return found
    try:
        float(found)
    except ValueError:
        return f"'{found}"
    return found
