"""Signals: at once where nothing moves, at the end of what must not be broken off."""

from __future__ import annotations

import signal
import threading

import pytest

from commissioning.errors import Interrupted
from commissioning.interruption import Interruption


def test_a_signal_is_raised_where_the_program_is_each_time() -> None:
    with Interruption() as interruption:
        for count in (1, 2):
            with pytest.raises(Interrupted, match="interrupted by SIGINT") as error:
                signal.raise_signal(signal.SIGINT)
            assert error.value.exit_code == 130
            assert interruption.count == count
        assert interruption.hurried()


def test_what_was_told_before_is_told_again_to_whoever_waits_then() -> None:
    with Interruption() as interruption:
        with pytest.raises(Interrupted, match="SIGTERM"), interruption.deferred():
            signal.raise_signal(signal.SIGTERM)
        interruption.check()  # once is enough for the clean-up
        with pytest.raises(Interrupted, match="SIGINT"):
            signal.raise_signal(signal.SIGINT)


def test_nothing_is_raised_before_the_outermost_block_ends() -> None:
    done: list[str] = []

    def work() -> None:
        with interruption.deferred():
            with interruption.deferred():
                signal.raise_signal(signal.SIGINT)
                done.append("inner")
            done.append("outer")

    with Interruption() as interruption, pytest.raises(Interrupted):
        work()
    assert done == ["inner", "outer"]
    assert not interruption.hurried()


def test_handlers_are_as_before_afterwards() -> None:
    before = signal.getsignal(signal.SIGINT)
    with Interruption():
        assert signal.getsignal(signal.SIGINT) != before
    assert signal.getsignal(signal.SIGINT) == before


def test_elsewhere_than_in_the_main_thread_no_handler_is_set() -> None:
    seen = []

    def work() -> None:
        before = signal.getsignal(signal.SIGINT)
        with Interruption():
            seen.append(signal.getsignal(signal.SIGINT) == before)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [True]
