"""Old runs give their room back; what was done to a drive stays known, and can be undone."""

from __future__ import annotations

import time

import pytest

from commissioning.journal import Journal
from drivers.home import home
from tests.conftest import Tworelay


def folders() -> set[str]:
    return {path.name for path in (home() / "runs").iterdir()}


def test_old_runs_go_and_those_with_anything_to_restore_stay(
    tworelay: Tworelay, after: Tworelay
) -> None:
    after("commission", "virtual://bench", "--yes")
    assert tworelay("identify", "virtual://bench?delay=0.003", "--yes").returncode == 0
    with Journal(home()) as journal:
        measured = journal.run("last").id
        written = journal.open_runs()[0]
    assert folders() == {measured, written}
    for before in ("2020-01-01", "1d"):
        done = tworelay("history", "prune", "--before", before, "--yes")
        assert done.stdout.strip() == "files of 0 run(s) deleted, 0.0 MB"
    shown = tworelay("history", "prune", "--before", "0d", "--dry-run")
    assert "files of 1 run(s) would be deleted" in shown.stdout
    assert f"kept: {written}" in shown.stdout
    refused = tworelay("history", "prune", "--before", "0d")
    assert refused.returncode == 3
    assert folders() == {measured, written}
    done = tworelay("history", "prune", "--before", "0d", "--yes")
    assert done.returncode == 0, done.stderr
    assert folders() == {written}
    gone = tworelay("report", measured)
    assert gone.returncode == 2
    assert "has no files here" in gone.stderr
    with Journal(home()) as journal:
        assert journal.intents(measured), "what it did stays known"
    assert tworelay("restore", "--yes", written).returncode == 0
    assert tworelay("history", "prune", "--before", "0d", "--yes").returncode == 0
    assert folders() == set()


@pytest.mark.parametrize("before", ["yesterday", "2026-13-01", "-1d", "1e9d", "", "99999999d"])
def test_a_date_that_is_none(tworelay: Tworelay, before: str) -> None:
    done = tworelay("history", "prune", "--before", before, "--yes")
    assert done.returncode == 2
    assert "2026-01-31" in done.stderr


def test_a_link_in_place_of_a_run_is_not_followed(
    tworelay: Tworelay, after: Tworelay, tmp_path_factory: pytest.TempPathFactory
) -> None:
    after("identify", "virtual://bench", "--yes")
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    (elsewhere / "mine").write_text("mine")
    path = next((home() / "runs").iterdir())
    path.rename(path.with_name("moved"))
    path.symlink_to(elsewhere)
    later = time.strftime("%Y-%m-%d", time.localtime(time.time() + 2 * 86400))
    done = tworelay("history", "prune", "--before", later, "--yes")
    assert done.returncode == 0
    assert f"kept: {path.name}" in done.stdout
    assert (elsewhere / "mine").exists()
