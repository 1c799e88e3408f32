"""Whether a process lives, and is still the one that was meant."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import psutil
import pytest

from commissioning.processes import is_alive, start, this_process
from tests.command import ROOT


def test_this_process_is_alive_and_is_told_from_a_later_one_of_its_number() -> None:
    me = this_process()
    assert me["pid"] == os.getpid()
    assert is_alive(me["pid"], me["started"])
    assert is_alive(me["pid"]), "by its number alone, as earlier versions noted it"
    assert not is_alive(me["pid"], me["started"] - 3600.0), "its number was given again"
    assert not is_alive(me["pid"], me["started"] + 3600.0)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems count by the clock")
def test_a_clock_that_is_set_makes_nobody_dead(monkeypatch: pytest.MonkeyPatch) -> None:
    me, boot, began = this_process(), psutil.boot_time, psutil.Process.create_time
    monkeypatch.setattr(psutil, "boot_time", lambda: boot() + 7200.0)
    monkeypatch.setattr(psutil.Process, "create_time", lambda self: began(self) + 7200.0)
    assert is_alive(me["pid"], me["started"])


@pytest.mark.parametrize("pid", [0, -1, 2**31, 2**70, None, "1", 1.5])
def test_what_is_no_number_of_a_process_is_not_alive(pid: object) -> None:
    assert not is_alive(pid)


def test_a_process_that_has_ended_is_not_alive_even_where_nobody_has_asked_how() -> None:
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        assert is_alive(process.pid)
        assert process.stdin is not None
        process.stdin.close()
        psutil.Process(process.pid)
        while psutil.Process(process.pid).status() != psutil.STATUS_ZOMBIE:
            pass
        assert not is_alive(process.pid)
    assert not is_alive(process.pid)


def test_a_process_of_another_user_counts_as_alive(monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(self: Any) -> str:
        raise psutil.AccessDenied

    monkeypatch.setattr(psutil.Process, "status", denied)
    assert is_alive(os.getpid())


@pytest.mark.skipif(os.name == "nt", reason="sessions are POSIX'")
def test_a_child_is_out_of_reach_of_a_ctrl_c_in_our_terminal() -> None:
    with start("commissioning", "--version", stdout=subprocess.PIPE, text=True) as child:
        assert os.getsid(child.pid) == child.pid != os.getsid(0)
        assert child.stdout is not None
        assert "version" in child.stdout.read()


@pytest.mark.parametrize("package", ["profiles", "drivers"])
def test_a_file_of_the_user_s_is_not_taken_for_a_package_of_ours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str
) -> None:
    """A child looks neither into the working directory nor past its parent's own folder."""
    (tmp_path / f"{package}.py").write_text("raise SystemExit('taken for ours')")
    monkeypatch.chdir(tmp_path)
    child = start("commissioning", "virtual", "list", stdout=subprocess.PIPE, text=True)
    said, _ = child.communicate(timeout=60)
    assert child.returncode == 0
    assert said.startswith("bench")


@pytest.mark.parametrize(("package", "is_folder"), [("profiles", False), ("drivers", True)])
def test_what_hides_a_package_of_ours_is_refused_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str, is_folder: bool
) -> None:
    hiding = tmp_path / (f"{package}/__init__.py" if is_folder else f"{package}.py")
    hiding.parent.mkdir(exist_ok=True)
    hiding.write_text("raise SystemExit('taken for ours')")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{ROOT}")
    words = f"{hiding} hides tworelay's own package '{package}' ({ROOT / package})"
    own = [sys.executable, "-P", "-m", "commissioning", "virtual", "list"]
    done = subprocess.run(own, check=False, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert done.stderr.startswith(f"tworelay: {words}: ")
    assert len(done.stderr.strip().splitlines()) == 1
    child = start("commissioning", "virtual", "list", stdout=subprocess.PIPE, text=True)
    said, _ = child.communicate(timeout=60)
    assert child.returncode == 2
    assert said.startswith(words)
