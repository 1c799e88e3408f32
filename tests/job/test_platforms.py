"""A job where everything is gone that only POSIX has: what runs on Windows by construction."""

from __future__ import annotations

import json
import os

import pytest

from commissioning.journal import Journal
from drivers.home import home
from drivers.link import axis_of, open_drive
from tests.command import ROOT, in_process
from tests.conftest import Serve
from tests.punctual import real_time
from tests.serving import WIRES

POSIXLESS = {"PYTHONPATH": str(ROOT / "tests" / "posixless"), "TWORELAY_POSIXLESS": "1"}
posix = pytest.mark.skipif(os.name == "nt", reason="here it is nothing but Windows")


@posix
def test_a_job_in_process_with_its_report() -> None:
    done = in_process(
        "commission",
        "virtual://bench",
        "--cycle",
        "0.008",
        "--yes",
        "--json",
        "-",
        environment=POSIXLESS,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["friction"]["coulomb"]["value"] == pytest.approx(0.1, rel=0.01)
    machine = in_process("doctor", environment=POSIXLESS)
    assert machine.returncode == 0, machine.stderr
    assert "no real-time priority to give" in machine.stdout
    for wire in ("--slcan", "--modbus-rtu"):
        refused = in_process("virtual", "serve", "bench", wire, "pty", environment=POSIXLESS)
        assert refused.returncode == 2
        assert "no pseudo-terminals: use --" in refused.stderr


@posix
@real_time
def test_a_job_in_real_time_through_the_guardian_that_owns_the_port(serve: Serve) -> None:
    (link,) = serve("bench", *WIRES["slcan"])
    options = ("--travel", "20", "--yes", "--cycle", "0.005", "--watchdog", "0.1", "--json", "-")
    done = in_process("identify", link, *options, environment=POSIXLESS)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["friction"]["coulomb"]["value"] == pytest.approx(0.1, rel=0.1)
    with Journal(home()) as journal:
        assert journal.history("last").events == (), "the guardian had nothing to do"
    drive = open_drive(axis_of(link))
    assert not drive.state().is_energised
    assert drive.read("max_torque").raw == 3000
    drive.close()
