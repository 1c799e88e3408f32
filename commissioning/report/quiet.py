"""Pictures of odd numbers and of names in any letters, without what the library has to say about them."""

from __future__ import annotations

import warnings
from collections.abc import Generator
from contextlib import contextmanager

__all__ = ["quiet"]


@contextmanager
def quiet() -> Generator[None]:
    """Meanwhile matplotlib warns nobody: of a range without a width, of a letter that its font lacks."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        yield
