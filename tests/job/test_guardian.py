"""The loop is killed; the drive has no watchdog of its own: its guardian stops it."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

from commissioning.journal import Journal
from drivers.home import home
from drivers.link import open_drive
from profiles.axis import Axis
from profiles.errors import LinkError
from tests.command import running
from tests.conftest import Serve, Tworelay
from tests.punctual import real_time
from tests.serving import WIRES

pytestmark = [real_time, pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")]

WITHOUT = """extends = "{base}"
name = "unwatched"
[watchdog]
kind = "none"
"""
HURRY = (
    "--travel",
    "20",
    "--yes",
    "--cycle",
    "0.01",
    "--without-watchdog",
    "--method",
    "two-relay",
)


@pytest.fixture(params=["modbus-tcp", "modbus-rtu", "slcan", "socketcand"])
def unwatched(request: pytest.FixtureRequest, serve: Serve, tmp_path: Path) -> Axis:
    """An axis whose drive would go on for ever, on each wire that crosses processes."""
    (link,) = serve("bench", *WIRES[request.param])
    base = "virtual-canopen" if link.startswith("canopen") else "virtual-modbus"
    profile = tmp_path / "unwatched.toml"
    profile.write_text(WITHOUT.format(base=base))
    drive = open_drive(Axis(link=link, profile=base))
    drive.write_raw("watchdog_time", 0)
    drive.close()
    return Axis(link=link, profile=str(profile))


def wait_for(process: subprocess.Popen[str], words: str) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        if words in line:
            return
    assert process.stderr is not None
    pytest.fail(f"'{words}' never came: {process.stderr.read()}")


def in_motion(tmp_path: Path, axis: Axis) -> list[str]:
    assert axis.link is not None
    assert axis.profile is not None
    return ["identify", axis.link, "--profile", axis.profile, *HURRY]


def left_energised(axis: Axis) -> bool:
    """Whether the drive is still enabled, some time after."""
    for _ in range(50):
        try:
            drive = open_drive(axis, to_stop=True)
        except LinkError:  # an exclusive port is the guardian's until it has ended
            time.sleep(0.1)
            continue
        try:
            if not drive.is_energised():
                return False
        finally:
            drive._energised = False  # looked at, not stopped
            drive.close()
        time.sleep(0.1)
    return True


def guardian_s_word() -> str:
    """What it wrote into the journal when it had done."""
    for _ in range(100):
        with Journal(home()) as journal:
            events = journal.export("last")["events"]
        said = [event["text"] for event in events if event["text"].startswith("guardian")]
        if said:
            return str(said[0])
        time.sleep(0.1)
    return ""


def test_the_loop_is_killed_and_the_axis_is_stopped(
    unwatched: Axis, tworelay: Tworelay, tmp_path: Path
) -> None:
    with running(*in_motion(tmp_path, unwatched)) as process:
        wait_for(process, "staging")
        process.kill()
        process.wait(10)
    assert "guardian: the loop has died" in guardian_s_word()
    assert not left_energised(unwatched)
    assert tworelay("restore").returncode == 0


def test_the_loop_is_frozen_and_the_axis_is_stopped(
    unwatched: Axis, tworelay: Tworelay, tmp_path: Path
) -> None:
    assert unwatched.link is not None
    if not unwatched.link.startswith(("modbus-tcp", "canopen://socketcand")):
        pytest.skip("while it lives, it owns the port: nobody else can look")
    with running(*in_motion(tmp_path, unwatched)) as process:
        wait_for(process, "staging")
        process.send_signal(signal.SIGSTOP)
        assert not left_energised(unwatched)
        process.send_signal(signal.SIGCONT)
        _, errors = process.communicate(timeout=30)
    assert process.returncode in (4, 5), errors
