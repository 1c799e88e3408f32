"""The guardian alone: an energised drive, and a loop that dies, falls silent, or has done."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Callable, Generator
from pathlib import Path

import pytest

import commissioning.guardian
from commissioning.guardian import Guardian, guarded
from commissioning.journal import Journal
from commissioning.records import RunContext
from commissioning.rig.armed import noted
from drivers.drive import StopReport
from drivers.errors import DriveFault, LinkError, LinkLost, PreflightRefused
from drivers.home import home
from drivers.link import open_drive
from drivers.profiled import ProfiledDrive
from profiles.axis import Axis
from profiles.procedures import Mode
from tests.commissioning.test_guardian_line import impatient
from tests.conftest import Serve
from tests.raising import raises
from tests.serving import WIRES

pytestmark = pytest.mark.skipif(os.name == "nt", reason="descriptors are inherited on POSIX")
_PATIENCE, _LOOK = 20.0, 0.02  # s for what takes a fraction of one
SILENT = "the loop was silent for more than 250 ms"


@contextlib.contextmanager
def energised(serve: Serve, wire: str, tmp_path: Path) -> Generator[tuple[ProfiledDrive, Guardian]]:
    """A drive without a watchdog that is left energised, and its guardian."""
    (link,) = serve("bench", *WIRES[wire])
    base = "virtual-canopen" if link.startswith("canopen") else "virtual-modbus"
    profile = tmp_path / "unwatched.toml"
    profile.write_text(
        f'extends = "{base}"\nname = "unwatched"\n[watchdog]\nkind = "none"\ntimeout = 2.0\n'
    )
    axis = Axis(link=link, profile=str(profile))
    drive = open_drive(axis, cycle=0.025)
    drive._bus.write(drive.profile.parameters["watchdog_time"].address, 0)
    try:
        with guarded(drive, axis, profile, begun(axis), home()) as guardian:
            drive.enable(Mode.TORQUE)
            drive.exchange(0.0)
            yield drive, guardian
        assert answered(drive, "max_torque") == 3000, "the way to the drive is ours, as before"
    finally:
        drive.close()


def begun(axis: Axis) -> str:
    """A run that the guardian can write to."""
    with Journal(home()) as journal:
        return journal.begin(
            axis="a",
            link=str(axis.link),
            profile="p",
            profile_hash="",
            serial="",
            context=RunContext("{}", 0.85),
        )


def answered(drive: ProfiledDrive, name: str) -> int | None:
    """A parameter; answers to the guardian's frames come to us, too, and are passed over."""
    until = time.monotonic() + _PATIENCE
    while time.monotonic() < until:
        with contextlib.suppress(LinkError):
            return drive.read(name).raw
        time.sleep(_LOOK)
    return None


def comes_to_rest(drive: ProfiledDrive) -> bool:
    """Whether the drive is without energy before long."""
    until = time.monotonic() + _PATIENCE
    while time.monotonic() < until:
        with contextlib.suppress(Exception):  # answers to the guardian's frames come to us
            if not drive.state().is_energised:
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
            events = [event.text for event in journal.history("last").events]
        if events:
            return events
        time.sleep(_LOOK)
    return []


def test_a_dead_loop_is_seen_at_once(serve: Serve, wire: str, tmp_path: Path) -> None:
    with energised(serve, wire, tmp_path) as (drive, guardian):
        assert guardian.reclaim is None, "it inherits a port, or connects"
        assert guardian._process is not None
        assert guardian._process.stdin is not None
        guardian._process.stdin.close()
        assert comes_to_rest(drive)
        assert said()[0].startswith("guardian: the loop has died; ")


@pytest.mark.parametrize("wire", ["modbus-tcp", "slcan"])  # each way to stop; the others above
def test_a_silent_loop_is_stopped_for_once_it_is_armed(
    serve: Serve, wire: str, tmp_path: Path
) -> None:
    with energised(serve, wire, tmp_path) as (drive, guardian):
        guardian.arm()
        assert comes_to_rest(drive)
        assert said()[0].startswith("guardian: the loop was silent for more than 250 ms; ")
        with pytest.raises(DriveFault, match=f"^the guardian process stopped the axis: {SILENT}$"):
            feed_for_long(guardian)
        assert noted(guardian)[0] == f"the guardian process stopped the axis: {SILENT}"
        assert noted(guardian)[1].startswith("guardian: ")


@pytest.fixture
def owner(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on Windows: a process inherits no port, so the guardian owns it."""
    monkeypatch.setattr(commissioning.guardian, "INHERITS", False)


serial = pytest.mark.parametrize("wire", ["modbus-rtu", "slcan"])


@serial
@pytest.mark.usefixtures("owner")
def test_the_loop_speaks_through_a_guardian_that_owns_the_port(
    serve: Serve, wire: str, tmp_path: Path
) -> None:
    with energised(serve, wire, tmp_path) as (drive, guardian):
        guardian.arm()
        for _ in range(20):
            sample = drive.exchange(0.05)  # less than the friction
            guardian.feed()
        assert sample.status.enabled
        assert sample.torque == pytest.approx(0.05, abs=2e-3)
        guardian.rest()
        assert drive.stop().deenergised
    assert drive._bus.port() is not None


@serial
@pytest.mark.usefixtures("owner")
def test_a_guardian_that_owns_the_port_stops_for_a_silent_loop(
    serve: Serve, wire: str, tmp_path: Path
) -> None:
    with energised(serve, wire, tmp_path) as (drive, guardian):
        guardian.arm()
        assert said()[0].startswith("guardian: the loop was silent for more than 250 ms; ")
        assert comes_to_rest(drive)  # it has ended, so the port is ours again


@serial
@pytest.mark.usefixtures("owner")
def test_the_port_of_a_guardian_that_dies_is_opened_here_and_the_axis_stopped(
    serve: Serve, wire: str, tmp_path: Path
) -> None:
    with energised(serve, wire, tmp_path) as (drive, guardian):
        guardian.arm()
        assert guardian._process is not None
        guardian._process.kill()
        guardian._process.wait()
        words = "the guardian process has ended.* through its port, which was opened here"
        with pytest.raises(DriveFault, match=words):
            feed_for_long(guardian)
        report = drive.stop()
        assert report.deenergised
        assert report.failures == ()


@serial
@pytest.mark.usefixtures("owner")
def test_a_guardian_that_hangs_keeps_nobody_from_stopping_the_axis(
    serve: Serve, wire: str, tmp_path: Path
) -> None:
    reports: list[StopReport] = []
    stops_before_close: list[int] = []
    with pytest.raises(LinkLost), energised(serve, wire, tmp_path) as (drive, guardian):  # noqa: PT012
        process, stop, close = guardian._process, drive.stop, drive.close
        assert process is not None

        def closed() -> None:
            stops_before_close.append(len(reports))
            close()

        drive.close = closed  # type: ignore[method-assign]
        drive.stop = lambda *arguments: reported(stop, reports)  # type: ignore[method-assign]
        process.send_signal(signal.SIGSTOP)
        process.wait = impatient(process.wait)  # type: ignore[method-assign]
        for _ in range(20):
            drive.exchange(0.05)
    assert stops_before_close == [1]
    assert reports[0].deenergised, "once its port was ours again"


def reported(stop: Callable[[], StopReport], reports: list[StopReport]) -> StopReport:
    reports.append(stop())
    return reports[-1]


@pytest.mark.usefixtures("owner")
def test_a_port_that_the_guardian_cannot_open_is_the_loop_s_again(
    serve: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(*arguments: object) -> None:
        raise RuntimeError("no process today")

    monkeypatch.setattr(commissioning.guardian, "_process", none)
    with (
        raises(PreflightRefused, "preflight.guardian"),
        energised(serve, "modbus-rtu", tmp_path),
    ):
        pass


def test_a_loop_that_rests_may_be_silent(serve: Serve, tmp_path: Path) -> None:
    with energised(serve, "modbus-tcp", tmp_path) as (drive, guardian):
        guardian.arm()
        guardian.rest()
        time.sleep(0.6)  # more than twice the silence that is a failure
        assert drive.state().is_energised
        drive.stop()
    with Journal(home()) as journal:
        assert journal.history("last").events == ()
