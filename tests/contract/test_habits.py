"""Each habit of a real drive on one link.

The job is done with the numbers of a drive without, or the way out
is named. `make habits` plays them on every link."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.virtual.habits import HABITS
from tests.conftest import Tworelay
from tests.habits.cases import CASES, MODBUS, Case, played

_ELSEWHERE = {"guarding": "slcan"}
_ON_A_LINE = {"duplicate", "echo", "noise", "fragments", "lost-answer"}


def _wire(case: Case) -> str:
    return _ELSEWHERE.get(case.habits[0], "socketcand") if not case.options else "socketcand"


@pytest.mark.parametrize("case", CASES["canopen"], ids=lambda case: case.name)
def test_on_canopen(case: Case, tworelay: Tworelay, tmp_path: Path) -> None:
    wanted = "survived" if case.on.get(_wire(case), case.refused) is None else "refused by name"
    assert played(case, _wire(case), tworelay, tmp_path) == wanted


@pytest.mark.parametrize("case", MODBUS, ids=lambda case: case.name)
def test_on_modbus(case: Case, tworelay: Tworelay, tmp_path: Path) -> None:
    wire = "modbus-rtu-tcp" if set(case.habits) & _ON_A_LINE else "modbus-tcp"
    wanted = "survived" if case.on.get(wire, case.refused) is None else "refused by name"
    assert played(case, wire, tworelay, tmp_path) == wanted


@pytest.mark.parametrize("case", CASES["virtual"], ids=lambda case: case.name)
def test_in_this_process(case: Case, tworelay: Tworelay, tmp_path: Path) -> None:
    wanted = "survived" if case.refused is None else "refused by name"
    assert played(case, "virtual", tworelay, tmp_path) == wanted


def test_no_habit_is_without_a_case() -> None:
    played = {
        habit.partition("=")[0] for cases in CASES.values() for c in cases for habit in c.habits
    }
    assert played == set(HABITS)
