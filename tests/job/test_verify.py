"""verify: the compensation is proved where it acts, and stays only if it helps."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from commissioning.journal import Journal
from drivers.home import home
from drivers.link import axis_of, open_drive
from tests.command import ROOT
from tests.conftest import Serve, Tworelay
from tests.interrupting import signalled
from tests.serving import WIRES

SCHEMA = json.loads((ROOT / "docs/run.schema.json").read_text())
NAMES = ("coulomb_positive", "coulomb_negative", "viscous_gain", "torque_offset")


def values(link: str) -> list[int]:
    drive = open_drive(axis_of(link))
    assert not drive.state().is_energised
    assert drive.read("max_torque").raw == 3000
    found = [drive.read(name).raw for name in NAMES]
    drive.close()
    return found


def identified(tworelay: Tworelay, link: str) -> dict[str, Any]:
    done = tworelay("identify", link, "--travel", "20", "--cycle", "0.004", "--yes", "--json", "-")
    assert done.returncode == 0, done.stderr
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def test_what_helps_stays_and_is_stored(serve: Serve, tworelay: Tworelay, tmp_path: Path) -> None:
    link = serve("bench", *WIRES["socketcand"], "--clock", "step")[0]
    run = identified(tworelay, link)["run"]
    done = tworelay("verify", run, "--yes", "--json", "-")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    jsonschema.validate(result, SCHEMA)
    found = result["verification"]
    assert [step["fraction"] for step in found["steps"]] == [0, 0.5, 0.7, 0.85]
    errors = [step["reversal_error"] for step in found["steps"]]
    assert errors == sorted(errors, reverse=True)
    # what is left of a reversal is in proportion to the friction that is left (the loop is linear)
    assert errors[1] / errors[0] == pytest.approx(0.5, abs=0.12)
    assert errors[3] / errors[0] == pytest.approx(0.15, abs=0.2)
    assert found["kept_fraction"] == 0.85
    assert values(link)[:2] == [85, 85]
    stored = json.loads((tmp_path / "drive-0.json").read_text())
    assert stored["coulomb_positive"] == 85
    page = Path(tworelay("report", run).stdout.strip()).read_text()
    assert "Does it help?" in page
    assert "stayed" in page
    assert tworelay("restore", "--yes", run).returncode == 0
    assert values(link) == [0, 0, 0, 0]


def test_what_makes_no_difference_does_not_stay(serve: Serve, tworelay: Tworelay) -> None:
    """4096 counts a turn: its following error is the encoder's, not friction's."""
    (link,) = serve("mx106", *WIRES["modbus-tcp"], "--clock", "step")
    done = tworelay(
        "commission", link, "--travel", "3.14", "--cycle", "0.008", "--yes", "--json", "-"
    )
    assert done.returncode == 8
    assert "the compensation does not help: error after reversals" in done.stderr
    assert "the values from before the run are back in the drive" in done.stderr
    drive = open_drive(axis_of(link))
    assert [drive.read(name).raw for name in NAMES] == [0, 0, 0, 0]
    drive.close()
    result = json.loads(done.stdout)
    assert result["verification"]["kept_fraction"] is None


@pytest.mark.parametrize("cycles", [100, 5000])  # without compensation; with some of it written
def test_interrupted_in_mid_step_the_drive_has_what_it_had(
    serve: Serve, tworelay: Tworelay, cycles: int
) -> None:
    (link,) = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")
    run = identified(tworelay, link)["run"]
    with signalled(signal.SIGINT, cycles):
        done = tworelay("verify", run, "--yes", "--cycle", "0.004")
    assert done.returncode == 130, done.stderr
    assert "interrupted by SIGINT" in done.stderr
    assert ("50 %" in done.stdout) is (cycles > 1000)
    assert values(link) == [0, 0, 0, 0]


def test_what_cannot_be_seen_at_work_is_refused(serve: Serve, tworelay: Tworelay) -> None:
    twin = ("--profile", "elmo-gold", "--socketcand", "127.0.0.1:0", "--clock", "step")
    (link,) = serve("bench", *twin)
    done = tworelay("identify", link, "--travel", "30", "--yes")
    assert done.returncode == 0, done.stderr
    done = tworelay("verify", "last", "--yes")
    assert done.returncode == 3
    assert "cannot be verified: it proposes no compensation" in done.stderr
    with Journal(home()) as journal:
        run = journal.run("last").id
    assert tworelay("verify", run + "x", "--yes").returncode == 2
