"""Gateways fail in some ways: no axis is started twice, and all is accounted for."""

from __future__ import annotations

import os

import pytest

from tests.faults.gateways import CASES, Case, held

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
SOME = CASES[::25]


@pytest.mark.parametrize("case", SOME, ids=[case.name for case in SOME])
def test_some_cases(case: Case) -> None:
    """`make gateway-faults` tries every one."""
    assert held(case) == ""


def test_there_are_enough_of_them() -> None:
    assert len(CASES) >= 200
    assert len(SOME) >= 10
    assert len({case.name for case in CASES}) == len(CASES)
