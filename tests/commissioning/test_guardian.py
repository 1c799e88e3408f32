"""The guardian alone: an energised drive, and a loop that dies, falls silent, or has done."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

from commissioning.guardian import Guardian, guarded
from commissioning.journal import Journal
from drivers.home import home
from drivers.link import open_drive
from drivers.profiled import ProfiledDrive
from profiles.axis import Axis
from profiles.errors import DriveFault
from profiles.schema import Mode
from tests.conftest import Serve
from tests.serving import WIRES

pytestmark = pytest.mark.skipif(os.name == "nt", reason="descriptors are inherited on POSIX")
_PATIENCE, _LOOK = 20.0, 0.02  # s for what takes a fraction of one


@contextlib.contextmanager
def energised(serve: Serve, wire: str, tmp_path: Path) -> Generator[tuple[ProfiledDrive, Guardian]]:
    """A drive without a watchdog that is left energised, and its guardian."""
    (link,) = serve("bench", *WIRES[wire])
    base = "virtual-canopen" if link.startswith("canopen") else "virtual-modbus"
    profile = tmp_path / "unwatched.toml"
    profile.write_text(f'extends = "{base}"\nname = "unwatched"\n[watchdog]\nkind = "none"\n')
    axis = Axis(link=link, profile=str(profile))
    drive = open_drive(axis, cycle=0.005)
    drive._bus.write(drive.profile.parameters["watchdog_time"].address, 0)
    try:
        with guarded(drive, axis, profile, begun(axis), home()) as guardian:
            drive.enable(Mode.TORQUE)
            drive.exchange(0.0)
            yield drive, guardian
    finally:
        drive.close()


def begun(axis: Axis) -> str:
    """A run that the guardian can write to."""
    with Journal(home()) as journal:
        described: dict[str, Any] = {"axis": {}, "fraction": 0.85}
        return journal.begin(
            axis="a",
            link=str(axis.link),
            profile="p",
            profile_hash="",
            serial="",
            context=described,
        )


def comes_to_rest(drive: ProfiledDrive) -> bool:
    """Whether the drive is without energy before long."""
    until = time.monotonic() + _PATIENCE
    while time.monotonic() < until:
        with contextlib.suppress(Exception):  # answers to the guardian's frames come to us
            if not drive.is_energised():
                return True
        time.sleep(_LOOK)
    return False


def feed_for_long(guardian: Guardian) -> None:
    until = time.monotonic() + _PATIENCE
    while time.monotonic() < until:
        guardian.feed()
        time.sleep(_LOOK)


def said() -> list[str]:
    """What the guardian wrote into the journal, when it has."""
    until = time.monotonic() + _PATIENCE
    while time.monotonic() < until:
        with Journal(home()) as journal:
            events = [str(event["text"]) for event in journal.export("last")["events"]]
        if events:
            return events
        time.sleep(_LOOK)
    return []


def test_a_dead_loop_is_seen_at_once(serve: Serve, wire: str, tmp_path: Path) -> None:
    with energised(serve, wire, tmp_path) as (drive, guardian):
        assert guardian._process is not None
        assert guardian._process.stdin is not None
        guardian._process.stdin.close()
        assert comes_to_rest(drive)
        assert said()[0].startswith("guardian: the loop has died; ")


def test_a_silent_loop_is_stopped_for_once_it_is_armed(
    serve: Serve, wire: str, tmp_path: Path
) -> None:
    with energised(serve, wire, tmp_path) as (drive, guardian):
        guardian.arm()
        assert comes_to_rest(drive)
        assert said()[0].startswith("guardian: the loop was silent for more than 250 ms; ")
        with pytest.raises(DriveFault, match="the guardian process has ended"):
            feed_for_long(guardian)


def test_a_loop_that_rests_may_be_silent(serve: Serve, tmp_path: Path) -> None:
    with energised(serve, "modbus-tcp", tmp_path) as (drive, guardian):
        guardian.arm()
        guardian.rest()
        time.sleep(0.6)  # more than twice the silence that is a failure
        assert drive.is_energised()
        drive.stop()
    with Journal(home()) as journal:
        assert journal.export("last")["events"] == []
