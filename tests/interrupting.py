"""Signals in a chosen cycle."""

from __future__ import annotations

import contextlib
import itertools
import signal
from collections.abc import Generator
from unittest.mock import patch

from drivers.profiled import ProfiledDrive
from drivers.sample import Sample

__all__ = ["signalled"]


@contextlib.contextmanager
def signalled(number: signal.Signals, cycles: int) -> Generator[None]:
    """This process gets a signal after so many cycles of a drive."""
    left = itertools.count(cycles, -1)
    exchange = ProfiledDrive.exchange

    def counted(drive: ProfiledDrive, set_point: float) -> Sample:
        if next(left) == 0:
            signal.raise_signal(number)
        return exchange(drive, set_point)

    with patch.object(ProfiledDrive, "exchange", counted):
        yield
