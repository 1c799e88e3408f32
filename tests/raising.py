"""An error by its code: what a test expects, whatever the sentence says."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager

import pytest

from profiles.errors import TwoRelayError

__all__ = ["raises"]


@contextmanager
def raises(
    kind: type[TwoRelayError], code: str, **facts: float | str
) -> Generator[pytest.ExceptionInfo[TwoRelayError]]:
    """An error of that kind with that code, and with those facts among its own."""
    with pytest.raises(kind) as caught:
        yield caught
    error = caught.value
    assert error.code == code, str(error)
    for name, value in facts.items():
        expected = value if isinstance(value, str) else pytest.approx(value, rel=1e-3)
        assert error.facts[name] == expected, str(error)
