"""The whole job as a user types it, on the same axis through every link and on both clocks."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from drivers.link import axis_of, open_drive
from tests.command import in_process
from tests.conftest import Serve, Tworelay
from tests.punctual import real_time
from tests.serving import WIRES


def commission(
    tworelay: Tworelay, link: str, *options: str, travel: str = "±3.14"
) -> dict[str, Any]:
    """identify → apply → read back → store → restore; returns the result JSON."""
    done = tworelay("identify", link, "--travel", travel, "--yes", "--json", "-", *options)
    assert done.returncode == 0, done.stderr
    result: dict[str, Any] = json.loads(done.stdout)
    assert result["status"] == "completed"
    assert result["schema"] == "tworelay.run/2"

    applied = tworelay("apply", result["run"], "--yes")
    assert applied.returncode == 0, applied.stderr
    drive = open_drive(axis_of(link))
    wanted = {item["parameter"]: item["new_raw"] for item in result["compensation"]}
    assert {name: drive.read(name).raw for name in wanted} == wanted
    assert not drive.state().is_energised
    assert drive.read("max_torque").raw == 3000, "the experiment's limit is put back"
    drive.close()

    restored = tworelay("restore", "--yes", result["run"])
    assert restored.returncode == 0, restored.stderr
    assert "coulomb_negative, coulomb_positive" in restored.stdout
    drive = open_drive(axis_of(link))
    assert drive.read("coulomb_positive").raw == 0
    drive.close()
    return result


def check(result: dict[str, Any], tolerance: float) -> None:
    coulomb = result["friction"]["coulomb"]
    assert coulomb["value"] == pytest.approx(0.1, rel=tolerance)
    assert coulomb["unit"] == "N.m"
    assert coulomb["low"] < coulomb["value"] < coulomb["high"]
    assert result["friction"]["method"] == "output-error"
    assert result["friction"]["inertia"]["value"] == pytest.approx(1e-3, rel=tolerance)


@pytest.mark.parametrize("cycle", [0.002, 0.005])
def test_in_process(tworelay: Tworelay, cycle: float) -> None:
    check(commission(tworelay, "virtual://bench", "--cycle", str(cycle)), 0.01)


@pytest.mark.parametrize("cycle", [0.002, 0.005])
def test_over_a_wire_step_by_step(
    tworelay: Tworelay, serve: Serve, wire: str, cycle: float
) -> None:
    link = serve("bench", *WIRES[wire], "--clock", "step")[0]
    result = commission(tworelay, link, "--cycle", str(cycle))
    check(result, 0.01)
    in_process = commission(tworelay, "virtual://bench", "--cycle", str(cycle))
    assert result["friction"]["coulomb"]["value"] == pytest.approx(
        in_process["friction"]["coulomb"]["value"], rel=0.005
    )


@real_time
def test_over_a_wire_in_real_time(serve: Serve) -> None:
    """In a process of its own, as a user has it; the other wires are tried step by step."""
    link = serve("bench", *WIRES["modbus-tcp"])[0]
    result = commission(in_process, link, "--cycle", "0.004", travel="±20")
    assert result["friction"]["coulomb"]["value"] == pytest.approx(0.1, rel=0.1)


def test_the_state_on_disk_survives_a_power_off(
    tworelay: Tworelay, serve: Serve, tmp_path: Path
) -> None:
    """Served drives keep what was stored in their state file."""
    link = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]
    done = tworelay("commission", link, "--travel", "20", "--yes", "--cycle", "0.008")
    assert done.returncode == 0, done.stderr
    state = json.loads((tmp_path / "drive-0.json").read_text())
    assert state["coulomb_positive"] == state["coulomb_negative"] > 80
    report = re.search(r"report (\S+)", done.stdout)
    assert report is not None
    assert Path(report[1]).read_text().startswith("<!DOCTYPE html>")


@real_time
def test_a_generic_profile_identifies_and_writes_nothing(tworelay: Tworelay, serve: Serve) -> None:
    link = serve("bench", *WIRES["socketcand"])[0]
    done = tworelay(
        "identify", link, "--profile", "cia402", "--travel", "20", "--yes", "--json", "-",
        "--cycle", "0.004",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["compensation"] == []
    assert result["friction"]["coulomb"]["value"] == pytest.approx(0.1, rel=0.1)
    refused = tworelay("apply", "last", "--yes")
    assert refused.returncode == 3
    assert "no friction compensation" in refused.stderr
