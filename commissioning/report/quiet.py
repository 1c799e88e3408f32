"""Pictures of odd numbers and of names in any letters, without the library's warnings."""

from __future__ import annotations

import warnings
from collections.abc import Generator
from contextlib import contextmanager

__all__ = ["quiet"]


@contextmanager
def quiet() -> Generator[None]:
    """Meanwhile matplotlib warns nobody.

    Of a range without a width, of a letter that its font lacks.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        yield
