"""Whoever looks on at a fleet run, and is asked."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import Protocol

from commissioning.result.fleet import FleetResult

__all__ = ["Answer", "Ask", "People"]


class Answer(Enum):
    """What became of a question."""

    YES = 1
    NO = 2
    NOBODY = 3  # the terminal is gone


Ask = Callable[[], Answer | None]  # None: not answered yet


class People(Protocol):
    """Whoever looks on, and is asked."""

    def tell(self, text: str) -> None:
        """One line."""

    def ask(self, text: str, word: str) -> Ask:
        """Ask for a word."""

    def withdraw(self) -> None:
        """The question needs no answer any more."""

    def show(self, result: FleetResult) -> None:
        """The run as it is now."""
