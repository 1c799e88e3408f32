"""Workers are heard, handed signals on, and let go: what only looks is not waited for."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from commissioning.desk import Options
from commissioning.fleet import crew as crews
from commissioning.fleet.crew import Crew
from commissioning.fleet.ledger import Ledger
from commissioning.fleet.messages import Order
from commissioning.processes import is_alive
from commissioning.result.fleet import Confirmed, JobState, Room
from drivers.link import axis_of

LINK = "virtual://bench"
pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")


def order(act: str, run: str = "") -> Order:
    axis = axis_of(LINK).model_dump_json()
    return Order("look" if act == "look" else "job", run, "a", 1, "identify", axis, Options())


def test_a_look_that_hangs_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(crews, "_TO_END", 0.1)
    crew = Crew(tmp_path)
    worker = crew.order(order("look"), anew=False)
    os.kill(worker.pid, signal.SIGSTOP)
    crew.close()
    assert not is_alive(worker.pid)


def test_one_that_moves_is_waited_for_and_hears_signals(
    tmp_path: Path, state_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(crews, "_TO_END", 0.1)
    with Ledger(state_folder) as ledger:
        run = ledger.begin("line", tmp_path, "identify", '{"axes": {}}', "me", ["a"])
        ledger.grant(run, "a", 1, Confirmed("me", "", "typed", Room(3.0, 1.0, 30.0)), "0x1")
        crew = Crew(tmp_path)
        worker = crew.order(order("job", run), anew=True)
        signals = iter([0])
        heard = crew.hear(30.0)
        assert heard is not None
        assert heard.report is not None
        assert heard.report.kind == "ready"
        while ledger.rows(run)["a"].state is JobState.GRANTED:
            crew.hear(0.02)
        crew.close(lambda: next(signals, 1))  # a Ctrl-C while it is waited for
        assert not is_alive(worker.pid)
        assert ledger.rows(run)["a"].state in (JobState.STOPPED, JobState.DONE)


def test_a_worker_that_dies_is_heard(tmp_path: Path) -> None:
    crew = Crew(tmp_path / "gone" / "folder")
    worker = crew.order(order("look"), anew=False)
    os.kill(worker.pid, signal.SIGKILL)
    while (heard := crew.hear(30.0)) is not None and heard.report is not None:
        pass
    assert heard is not None
    crew.buried(worker)
    assert crew.at_work() == {}
    crew.close()
