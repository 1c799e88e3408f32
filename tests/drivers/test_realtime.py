"""The loop's priority: taken where it is permitted, and given back."""

from __future__ import annotations

import os

import pytest

from drivers.realtime import real_time


@pytest.mark.skipif(not hasattr(os, "sched_setscheduler"), reason="no real-time priority here")
def test_the_priority_is_taken_and_given_back() -> None:
    before = os.sched_getscheduler(0)
    with real_time() as granted:
        assert os.sched_getscheduler(0) == (os.SCHED_FIFO if granted else before)
    assert os.sched_getscheduler(0) == before


def test_an_error_in_the_loop_gives_it_back_too() -> None:
    before = os.sched_getscheduler(0) if hasattr(os, "sched_getscheduler") else None
    with pytest.raises(ZeroDivisionError), real_time():
        1 / 0  # noqa: B018
    if before is not None:
        assert os.sched_getscheduler(0) == before
