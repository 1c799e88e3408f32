"""Scanning: nothing is missed, nothing is disturbed, and what is not there is not found."""

from __future__ import annotations

import json
import uuid

import pytest

from drivers.errors import LinkError
from drivers.scan import scan
from profiles.errors import UsageError
from tests.conftest import Serve, Tworelay
from tests.peers import Nodes, gateway
from tests.raising import raises


def quiet(step: int) -> None:
    return None


def test_units_behind_a_gateway_are_found_and_no_others() -> None:
    there = {3: "data", 17: "exception", 100: "data", 247: "data"}
    with gateway(there, "gateway") as port:
        found = scan(f"modbus-tcp://127.0.0.1:{port}", range(1, 248), None, quiet)
    assert [item.address for item in found] == sorted(there)
    assert found[0].link == f"modbus-tcp://127.0.0.1:{port}?unit=3"
    assert found[0].note == "does not say who it is (no FC 43/14)"


def test_a_silent_unit_costs_its_time_out_and_is_not_found() -> None:
    with gateway({2: "data"}, "silence") as port:
        found = scan(f"modbus-tcp://127.0.0.1:{port}", range(1, 5), 0.05, quiet)
    assert [item.address for item in found] == [2]


def test_a_server_that_answers_to_every_number_is_one_drive() -> None:
    with gateway({}, "data") as port:
        found = scan(f"modbus-tcp://127.0.0.1:{port}", range(1, 248), None, quiet)
    assert [item.note for item in found] == ["answers to every unit number: it is one drive"]


@pytest.mark.parametrize("drives", [set(), {5}, {1, 64, 127}, set(range(1, 128))])
def test_nodes_on_a_can_bus_are_found_and_nothing_is_written(drives: set[int]) -> None:
    channel = uuid.uuid4().hex
    nodes = Nodes(channel, drives, {9, 30} - drives)
    try:
        found = scan(f"canopen://virtual/{channel}", range(0), None, quiet)
    finally:
        nodes.close()
    assert [f.address for f in found if f.identity is not None] == sorted(drives)
    assert {f.address for f in found if f.identity is None} == {9, 30} - drives
    assert nodes.written == []
    for item in found:
        if item.identity is not None:
            assert item.identity.vendor == f"0x{item.address * 16 + 1:08X}"
            assert ("no torque mode" in item.note) == (item.address % 2 == 0)
        else:
            assert item.note == "heartbeat only: it answers no SDO"


@pytest.mark.parametrize("kind", ["--modbus-tcp", "--socketcand"])
def test_the_command_names_drive_profile_and_link(
    serve: Serve, tworelay: Tworelay, kind: str
) -> None:
    (link,) = serve("bench", kind, "127.0.0.1:0")
    done = tworelay("scan", link.partition("?")[0], "--units", "1-3", "--timeout", "0.1", "--json")
    assert done.returncode == 0, done.stderr
    (found,) = json.loads(done.stdout)
    assert found["profiles"] == ["virtual-modbus" if "modbus" in kind else "virtual-canopen"]
    assert found["link"].split("&")[0] == link.split("&")[0]


def test_what_cannot_be_scanned_is_said() -> None:
    with pytest.raises(UsageError, match="serve the axis"):
        scan("virtual://bench", range(1), None, quiet)
    with raises(LinkError, "link.connect"):
        scan("modbus-tcp://127.0.0.1:1", range(1), None, quiet)


def test_a_wrong_range_of_units_is_a_plain_line(tworelay: Tworelay) -> None:
    done = tworelay("scan", "modbus-tcp://127.0.0.1:1", "--units", "5-2")
    assert done.returncode == 2
    assert "must be A-B" in done.stderr
