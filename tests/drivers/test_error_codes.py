"""Error codes in words, against the tables of CiA 301 and CiA 402."""

from __future__ import annotations

import pytest

from drivers.error_codes import is_of_communication, register_words, words


@pytest.mark.parametrize(
    ("code", "part"),
    [
        (0x8130, "heartbeat"), (0x8250, "PDO"), (0x8140, "bus-off"), (0x8611, "following error"),
        (0x3210, "DC link"), (0x2310, "overcurrent"), (0x7305, "encoder"), (0x4210, "too hot"),
        (0x2399, "current at the motor"), (0x34FF, "voltage"), (0xFF17, "vendor"), (0x8199,
        "communication"),
    ],
)  # fmt: skip
def test_a_code_in_words(code: int, part: str) -> None:
    assert part in words(code)


def test_what_no_standard_knows_is_not_made_up() -> None:
    assert words(0x0001) == words(0xA123) == ""


def test_bits_of_the_error_register() -> None:
    """CiA 301, 7.5.2.2.

    Generic, current, voltage, temperature, communication, profile, reserved, vendor.
    """
    assert register_words(0x11) == "generic, communication"
    assert register_words(0x8E) == "current, voltage, temperature, vendor"
    assert register_words(0) == ""


@pytest.mark.parametrize(
    ("code", "is_one"),
    [(0, True), (0x8130, True), (0x8250, True), (0x7500, True), (0xFF01, True), (0xA000, True),
     (0x2310, False), (0x8611, False), (0x3220, False)],
)  # fmt: skip
def test_which_codes_may_say_that_the_master_is_silent(code: int, is_one: bool) -> None:
    assert is_of_communication(code) is is_one
