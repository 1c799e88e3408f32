"""Restore: after a store that failed, from an exported run, against what somebody changed since."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path

from drivers.link import axis_of, open_drive
from tests.command import ROOT
from tests.conftest import Serve, Tworelay
from tests.serving import WIRES

QUICK = ("--travel", "20", "--cycle", "0.008", "--yes")  # few exchanges over the wire
FAILING_STORE = textwrap.dedent(
    """
    import sys
    from drivers.profiled import ProfiledDrive
    from drivers.errors import WriteFailed

    def broken(self):
        raise WriteFailed("the memory of the drive is worn out")

    ProfiledDrive.store = broken
    sys.argv = ["tworelay", *sys.argv[1:]]
    from commissioning.cli import main
    main()
    """
)


def test_a_store_that_failed_is_done_again(
    tworelay: Tworelay, serve: Serve, tmp_path: Path
) -> None:
    state = tmp_path / "drive-0.json"
    link = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]

    def with_broken_store(*arguments: str) -> None:
        done = subprocess.run(
            [sys.executable, "-c", FAILING_STORE, *arguments], cwd=ROOT, env=os.environ,
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 7, done.stderr
        assert "worn out" in done.stderr

    assert tworelay("identify", link, *QUICK).returncode == 0
    told = tmp_path / "result.json"
    with_broken_store("apply", "last", "--yes", "--json", str(told))
    assert json.loads(told.read_text())["status"] == "failed", "JSON on every exit from 3 up"
    assert not state.exists()
    assert tworelay("apply", "last", "--yes").returncode == 0, "the values were there, unstored"
    assert json.loads(state.read_text())["coulomb_positive"] > 0
    with_broken_store("restore", "--yes")
    assert json.loads(state.read_text())["coulomb_positive"] > 0
    assert tworelay("restore", "--yes").returncode == 0
    assert json.loads(state.read_text())["coulomb_positive"] == 0


def test_restore_refuses_a_value_that_somebody_changed_since(
    tworelay: Tworelay, serve: Serve
) -> None:
    link = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]
    assert tworelay("commission", link, *QUICK).returncode == 0
    drive = open_drive(axis_of(link))
    drive.write("coulomb_positive", 42)
    drive.close()
    refused = tworelay("restore", "--yes")
    assert refused.returncode == 7
    assert "skipped coulomb_positive (it reads 42" in refused.stderr
    assert tworelay("restore", "--yes", "--force").returncode == 0


def test_an_exported_run_is_a_run(
    tworelay: Tworelay, serve: Serve, tmp_path: os.PathLike[str]
) -> None:
    link = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]
    assert tworelay("commission", link, *QUICK).returncode == 0
    folder = os.path.join(tmp_path, "exported")  # noqa: PTH118
    exported = tworelay("export", "last", folder)
    assert exported.returncode == 0
    assert "samples.csv" in exported.stdout
    elsewhere = {"TWORELAY_HOME": os.path.join(tmp_path, "elsewhere")}  # noqa: PTH118
    assert tworelay("report", folder, environment=elsewhere).returncode == 0
    for act in ("apply", "verify", "restore"):
        refused = tworelay(act, folder, "--yes", environment=elsewhere)
        assert refused.returncode == 3
        assert f"adopt it first ('tworelay adopt {folder}')" in refused.stderr
    taken = tworelay("adopt", folder, "--yes", environment=elsewhere)
    assert taken.returncode == 0, taken.stderr
    run = taken.stdout.split()[-1]
    restored = tworelay("restore", run, "--yes", environment=elsewhere)
    assert restored.returncode == 0, restored.stderr
    assert "coulomb_negative, coulomb_positive" in restored.stdout
