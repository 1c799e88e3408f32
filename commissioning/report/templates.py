"""The templates of the pages: what comes from outside is escaped, and acts on nothing."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

import jinja2

from commissioning.result import words
from commissioning.result.found import Quantity
from commissioning.result.language import said
from profiles.plain import plain

__all__ = ["template"]


@cache
def template(name: str) -> jinja2.Template:
    """One of the templates beside this file."""
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        finalize=_plain,
    )  # fmt: skip
    environment.filters |= {
        "si": _si, "seconds": words.duration, "brief": _brief, "remaining": words.remaining,
        "found": _found, "css": _css,
    }  # fmt: skip
    environment.globals["_"] = said
    environment.tests |= {"search": lambda text, part: part in text}
    return environment.from_string((files("commissioning.report") / name).read_text("utf-8"))


def _css(text: str) -> str:
    """A text within the quotes of a style sheet."""
    return "".join(c if c.isalnum() or c in " ·.-_:+" else f"\\{ord(c):x} " for c in plain(text))


def _found(quantity: Quantity) -> str:
    """A number to what it is uncertain by, with its unit."""
    of = words.unit(quantity.unit)
    return words.measured(quantity.value, quantity.low, quantity.high, of)


def _brief(value: float | None) -> str:
    """Three digits, or a dash."""
    return "–" if value is None else f"{value:.3g}"


def _plain(value: object) -> object:
    """Texts of others act on no browser, either."""
    return plain(value) if type(value) is str else value


def _si(value: float | None, unit: str = "") -> str:
    """Four digits and the unit, or a dash."""
    return words.number(value, words.unit(unit))
