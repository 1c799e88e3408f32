"""doctor and latency: what a technician asks when a link does not do what it should."""

from __future__ import annotations

import json
from typing import Any

import pytest

from tests.conftest import Serve, Tworelay
from tests.punctual import real_time
from tests.serving import WIRES


def findings(tworelay: Tworelay, *arguments: str) -> tuple[int, list[dict[str, Any]]]:
    done = tworelay("doctor", *arguments, "--json")
    assert "Traceback" not in done.stderr
    return done.returncode, json.loads(done.stdout)


def test_the_machine_is_looked_at(tworelay: Tworelay) -> None:
    code, found = findings(tworelay)
    assert code == 0
    texts = " ".join(f["text"] for f in found)
    for words in ("Python 3", "pymodbus 3.16", "state folder", "a sleep of 2 ms"):
        assert words in texts


def test_a_link_that_works_is_said_to_work(serve: Serve, tworelay: Tworelay, wire: str) -> None:
    (link,) = serve("bench", *WIRES[wire])
    code, found = findings(tworelay, link)
    assert code == 0, found
    assert any(f["level"] == "ok" and "answers" in f["text"] for f in found)


def test_a_wrong_node_is_named_with_those_that_answer(serve: Serve, tworelay: Tworelay) -> None:
    (link,) = serve("bench", *WIRES["socketcand"])
    code, found = findings(tworelay, link.replace("node=5", "node=6"))
    assert code == 4
    (problem,) = [f["text"] for f in found if f["level"] == "problem"]
    assert problem == "node: 6 does not answer to SDO; nodes 5 do"


def test_a_wrong_unit_is_named_with_those_that_answer(
    serve: Serve, tworelay: Tworelay, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.doctor._ANSWER", 0.2)
    (link,) = serve("bench", *WIRES["modbus-rtu"])
    code, found = findings(tworelay, link.replace("unit=1", "unit=7"))
    assert code == 4
    texts = [f["text"] for f in found]
    assert "unit: 7 does not answer within 0.2 s" in texts
    assert "unit: these answer: [1]" in texts


def test_a_closed_port_is_a_problem(tworelay: Tworelay) -> None:
    code, found = findings(tworelay, "modbus-tcp://127.0.0.1:1")
    assert code == 4
    assert found[-1]["text"].startswith("connection: cannot connect to 127.0.0.1:1")


@real_time
@pytest.mark.parametrize("wire", ["modbus-tcp", "modbus-rtu", "slcan"])
def test_latency_tells_the_cycle_that_the_link_holds(
    serve: Serve, tworelay: Tworelay, wire: str
) -> None:
    (link,) = serve("bench", *WIRES[wire])
    done = tworelay("latency", link, "--count", "100", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["cycle"] >= found["exchange"]["p99"]
    assert found["shortest_period"] == pytest.approx(24 * found["cycle"])
    if wire == "modbus-rtu":  # two silences of 1.75 ms at least, by the standard
        assert found["exchange"]["median"] > 0.00175


@real_time
def test_torque_steps_tell_how_late_a_torque_acts(serve: Serve, tworelay: Tworelay) -> None:
    (link,) = serve("bench", "--set", "delay=0.02", *WIRES["modbus-tcp"])
    asked = ("latency", link, "--count", "50", "--json", "--move", "--travel", "20")
    refused = tworelay(*asked)
    assert refused.returncode == 3
    assert "this needs a confirmation" in refused.stderr
    done = tworelay(*asked, "--yes")
    assert done.returncode == 0, done.stderr
    late = json.loads(done.stdout)["dead_time"]
    assert late["value"] == pytest.approx(0.02, abs=0.003)
    assert late["low"] < late["value"] < late["high"]
    nothing = tworelay("apply", "last", "--yes")
    assert nothing.returncode == 3
    assert "proposes nothing: it measured no friction" in nothing.stderr


def test_latency_does_not_energise_and_says_what_it_cannot_measure(
    serve: Serve, tworelay: Tworelay
) -> None:
    (link,) = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")
    done = tworelay("latency", link)
    assert done.returncode == 2
    assert "has no time" in done.stderr
    assert tworelay("latency", "virtual://bench").returncode == 2
