"""The language that people are spoken to in: words, and the decimal sign. English is built in."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Generator, Mapping
from contextvars import ContextVar

from commissioning.result.german import GERMAN

__all__ = ["LANGUAGES", "digits", "language", "said", "speaking", "usual"]

LANGUAGES: Mapping[str, Mapping[str, str]] = {"en": {}, "de": GERMAN}
_SPOKEN: ContextVar[str] = ContextVar("language", default="en")
_DECIMAL = re.compile(r"(?<![\d.])(\d+)\.(\d+)(?![\d.]*\.\d)")


def language() -> str:
    """The language that is spoken now."""
    return _SPOKEN.get()


@contextlib.contextmanager
def speaking(name: str) -> Generator[None]:
    """Speak one of LANGUAGES."""
    token = _SPOKEN.set(name if name in LANGUAGES else "en")
    try:
        yield
    finally:
        _SPOKEN.reset(token)


def usual() -> str:
    """The language of this computer, where it is one of LANGUAGES; else English."""
    for name in ("TWORELAY_LANGUAGE", "LC_ALL", "LC_MESSAGES", "LANG"):
        value = os.environ.get(name, "")[:2].lower()
        if value:
            return value if value in LANGUAGES else "en"
    return "en"


def said(text: str) -> str:
    """A text of ours in the language that is spoken; one without a translation as it is."""
    return LANGUAGES[_SPOKEN.get()].get(text, text)


def digits(text: str) -> str:
    """Numbers in a text with the decimal sign of the language."""
    return _DECIMAL.sub(r"\1,\2", text) if _SPOKEN.get() == "de" else text
