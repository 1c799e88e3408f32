"""Options that every command has."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

__all__ = ["is_quiet", "is_verbose", "verbose"]

F = TypeVar("F", bound=Callable[..., Any])
_HOW_MUCH = "tworelay.how-much"  # is said, in the context: 1 more, -1 less than usual


def _how_much(context: click.Context, parameter: click.Parameter, is_given: bool) -> None:
    if is_given:
        context.meta[_HOW_MUCH] = 1 if parameter.name == "verbose" else -1


# the entry point looks for -v on the command line, whatever failed
_OPTIONS = (
    click.option(
        "-v", "--verbose", is_flag=True, expose_value=False, callback=_how_much, is_eager=True,
        help="Say more: every phase, the theory, and a traceback if there is a bug.",
    ),
    click.option(
        "-q", "--quiet", is_flag=True, expose_value=False, callback=_how_much, is_eager=True,
        help="Say the result alone.",
    ),
)  # fmt: skip


def verbose(function: F) -> F:
    """-v and -q."""
    for option in reversed(_OPTIONS):
        function = option(function)
    return function


def is_verbose() -> bool:
    """Whether more than usual is to be said."""
    return _said() > 0


def is_quiet() -> bool:
    """Whether less than usual is to be said."""
    return _said() < 0


def _said() -> int:
    context = click.get_current_context(silent=True)
    return 0 if context is None else int(context.meta.get(_HOW_MUCH, 0))
