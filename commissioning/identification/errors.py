"""What a record does not show, in words for people, whatever library found it out."""

from __future__ import annotations

__all__ = ["NotShown", "words_of"]

_NO_SOLUTION = (
    "its numbers lead to no solution: is a column constant, empty for the most part, or in a unit "
    "that makes it huge or tiny?"
)


class NotShown(ValueError):
    """A record that is too short, too poor or contradicts itself; the text says which."""


def words_of(error: Exception) -> str:
    """One line for people: our own words, or what a failure inside a library means."""
    return str(error) if isinstance(error, NotShown) else _NO_SOLUTION
