"""The driver's state machine against the coding table of CiA 402."""

from __future__ import annotations

import pytest

from drivers.cia402 import next_controlword, state, status

# CiA 402, statusword: xxxx xxxx x0xx 0000 b and so on, each with the don't-care bits set and clear
TABLE = [
    (0x0000, "not ready to switch on"), (0xFFB0, "not ready to switch on"),
    (0x0040, "switch on disabled"), (0xFFF0, "switch on disabled"),
    (0x0021, "ready to switch on"), (0xFFB1, "ready to switch on"),
    (0x0023, "switched on"), (0xFFB3, "switched on"),
    (0x0027, "operation enabled"), (0xFFB7, "operation enabled"),
    (0x0007, "quick stop active"), (0xFF97, "quick stop active"),
    (0x000F, "fault reaction active"), (0xFFBF, "fault reaction active"),
    (0x0008, "fault"), (0xFFB8, "fault"),
]  # fmt: skip


@pytest.mark.parametrize(("word", "name"), TABLE)
def test_state_coding(word: int, name: str) -> None:
    assert state(word) == name


def test_an_impossible_statusword_is_named_not_guessed() -> None:
    assert state(0x0041) == "unknown (0041h)"


def test_the_way_up_and_down() -> None:
    assert [next_controlword(word, enabled=True) for word in (0x40, 0x21, 0x23)] == [6, 7, 15]
    assert next_controlword(0x27, enabled=True) is None
    assert next_controlword(0x08, enabled=True) is None, "a fault is never walked out of"
    assert [next_controlword(word, enabled=False) for word in (0x27, 0x23, 0x21)] == [7, 6, 0]


def test_flags() -> None:
    assert status(0x0A37).enabled
    assert status(0x0A37).limit
    assert status(0x0008).fault
    assert status(0x0007).stopping
    assert not status(0x0240).enabled
