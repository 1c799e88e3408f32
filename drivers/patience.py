"""A drive that is busy, or still boots, is asked again: "not yet" is no refusal."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from drivers.errors import AccessDenied, NoAnswer

__all__ = ["patiently", "when_up"]

T = TypeVar("T")
_ROUNDING = 1e-6  # s


def patiently(action: Callable[[], T], patience: float, wait: Callable[[], float]) -> T:
    """What `action` gives, asked again for `patience` s while the drive says that it is busy.

    `wait` lets some time pass and says how much, s. Raises AccessDenied, and says how long it was
    asked.
    """
    waited = 0.0
    while True:
        try:
            return action()
        except AccessDenied as error:
            if not error.busy:
                raise
            if waited > patience - _ROUNDING:
                error.also(
                    f"it was asked again for {waited:.3g} s ([link] patience in the profile)"
                )
                raise
        waited += wait()


def when_up(action: Callable[[], T], patience: float, silence: float) -> T:
    """What `action` gives, asked again for `patience` s while nothing answers.

    The drive may still boot.

    `silence` : s that each question takes to be given up. Raises NoAnswer.
    """
    waited = 0.0
    while True:
        try:
            return action()
        except NoAnswer as error:
            waited += silence
            if waited > patience - _ROUNDING:
                if patience:
                    error.also(f"it was asked for {waited:.3g} s")
                raise
