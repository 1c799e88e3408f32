"""Runs of an older version, cut off in the middle.

Stopped and restored by the profile that lies in them.

In tests/recordings: what version 0.1.0 had written at commit 51a2cf0 when it was killed while its
axis moved. Both profiles are refused today: one has a register by two names, the other's
compensation acts in torque mode only.
"""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
from pathlib import Path
from typing import Any

import pytest

from commissioning.journal import Journal
from drivers.home import home
from drivers.link import open_drive
from profiles.axis import Axis
from tests.command import ROOT
from tests.conftest import Serve, Tworelay
from tests.serving import WIRES

RECORDINGS = ROOT / "tests" / "recordings"
CASES = {"modbus": ("modbus-tcp", "virtual-modbus"), "canopen": ("socketcand", "virtual-canopen")}
COMMANDS = {"mode_of_operation", "torque_target", "position_target"}


def left_behind(case: str) -> tuple[str, Path]:
    """The state of a computer whose job was killed; its run, and the profile in it."""
    source = RECORDINGS / f"cut_off_{case}"
    home().mkdir(parents=True)
    with contextlib.closing(sqlite3.connect(home() / "journal.sqlite")) as db:
        db.executescript((source / "journal.sql").read_text("utf-8"))
        run = str(db.execute("SELECT id FROM runs").fetchone()[0])
    folder = home() / "runs" / run
    folder.mkdir(parents=True)
    shutil.copy(source / "profile.toml", folder)
    return run, folder / "profile.toml"


def of_the_drive(link: str, profile: str) -> None:
    """The recorded run is said to be of the drive that is served here."""
    drive = open_drive(Axis(link=link, profile=profile))
    serial = drive.identity().serial
    drive.close()
    with contextlib.closing(sqlite3.connect(home() / "journal.sqlite")) as db:
        db.execute("UPDATE runs SET serial=?", (serial,))
        db.commit()


@pytest.mark.parametrize("case", CASES)
def test_a_run_that_an_older_version_left_is_finished(
    serve: Serve, tworelay: Tworelay, case: str
) -> None:
    wire, known = CASES[case]
    run, profile = left_behind(case)
    link = serve("bench", *WIRES[wire], "--clock", "step")[0]
    of_the_drive(link, known)
    assert tworelay("identify", link, "--profile", str(profile), "--yes").returncode == 2
    drive: Any = open_drive(Axis(link=link, profile=known))
    with Journal(home()) as journal:
        intents = [i for i in journal.intents(run) if i.parameter in drive.profile.parameters]
    for intent in intents:  # what the job had done when it was killed
        drive._bus.write(drive.profile.parameters[intent.parameter].address, intent.new)
    drive.close()
    refused = tworelay("restore", "--link", link)
    assert refused.returncode == 3
    assert "give --yes" in refused.stderr
    assert tworelay("stop", link, "--profile", str(profile)).returncode == 0
    done = tworelay("restore", "--link", link, "--yes")
    assert done.returncode == 0, done.stderr
    drive = open_drive(Axis(link=link, profile=known))
    for name in {i.parameter for i in intents} - COMMANDS:
        oldest = next(i.old for i in intents if i.parameter == name)
        assert drive.read(name).raw == oldest, name
    assert drive.read("torque_target").raw == 0
    assert not drive.state().is_energised
    drive.close()
    assert tworelay("restore", "--yes").stdout.strip() == "nothing to restore"
