"""LINKs: what they are split into, and what is said of a wrong one."""

from __future__ import annotations

import pytest

from drivers.link import axis_of, is_simulated, open_drive, parse, state_file
from profiles.axis import Axis
from profiles.errors import UnknownName, UsageError


def test_a_link_is_split_into_scheme_place_and_options() -> None:
    link = parse("canopen://slcan/%2Fdev%2FttyACM0?node=5&bitrate=500000")
    assert (link.scheme, link.place) == ("canopen", "slcan/%2Fdev%2FttyACM0")
    assert link.integer("node", 1, 127) == 5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("http://x", "a link begins with"),
        ("bench", "a link begins with"),
        ("virtual://bench?coulomb", "key=value"),
        ("modbus-tcp://h:1?unit=999", "unit=999 must be a whole number 0…255"),
        ("modbus-tcp://h:99999", "modbus-tcp://HOST:PORT"),
        ("modbus-tcp://h:1?nit=1", "no option 'nit'"),
        ("modbus-tcp://h:1?clock=fast", "clock is wall or step"),
        ("modbus-tcp://h:1?timeout=0", "timeout=0"),
        ("canopen://socketcan/can0", "a CANopen link is"),
        ("canopen://socketcan/can0?node=200", "node=200"),
        ("canopen://socketcand/nohost?node=5", "socketcand/HOST:PORT/CHANNEL"),
        ("canopen://nosuch/can0?node=5", "no CAN interface 'nosuch'"),
        ("virtual://bench?coulomb=abc", "must be a number"),
        ("virtual://bench?inertia=0", "inertia is 0"),
        ("virtual://bench?breakaway=0.01", "breakaway"),
    ],
)
def test_a_wrong_link_says_what_is_wrong(text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message.replace("?", r"\?")):
        open_drive(axis_of(text))


def test_unknown_names_list_the_known_ones() -> None:
    with pytest.raises(
        UnknownName, match=r"bench, emps, epos-antibacklash, .*thesis-motor, .*vertical"
    ):
        axis_of("virtual://nosuch")
    with pytest.raises(UnknownName, match="coulomb"):
        axis_of("virtual://bench?friction=1")


def test_a_profile_of_another_bus_is_refused() -> None:
    with pytest.raises(UsageError, match="is for canopen, the link is modbus-tcp"):
        open_drive(Axis(link="modbus-tcp://127.0.0.1:1", profile="cia402"))


@pytest.mark.parametrize(
    ("text", "simulated"),
    [
        ("virtual://bench", True), ("modbus-tcp://127.0.0.1:502", True),
        ("modbus-tcp://localhost", True), ("modbus-tcp://192.168.1.5", False),
        ("modbus-tcp://[::1]:502", True), ("canopen://slcan/%2Fdev%2Fpts%2F3?node=5", True),
        ("canopen://slcan/%2Fdev%2FttyACM0?node=5", False),
        ("canopen://socketcand/127.0.0.1:29536/can0?node=5", True),
        ("canopen://socketcand/10.0.0.5:29536/can0?node=5", False),
        ("canopen://socketcan/can0?node=5", False),
    ],
)  # fmt: skip
def test_what_is_simulated(text: str, simulated: bool) -> None:
    assert is_simulated(text) is simulated


def test_the_same_name_and_options_are_the_same_drive() -> None:
    one, two = parse("virtual://bench?coulomb=0.2"), parse("virtual://bench?coulomb=0.20")
    assert state_file(one) == state_file(two)
    assert state_file(one) != state_file(parse("virtual://bench"))
    assert str(state_file(parse("virtual://bench?state=/x/y.json"))) == "/x/y.json"
