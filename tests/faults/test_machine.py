"""The machine fails within a job.

The axis comes to rest without energy, in one line with the right code.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.faults.machine import DELAYS, JOBS, Fault, Job, one, phases
from tests.faults.two_key import in_process


@pytest.fixture(autouse=True)
def two_keys() -> Iterator[None]:
    with in_process():
        yield


@pytest.mark.parametrize("job", JOBS, ids=str)
def test_each_fault_in_some_phase(job: Job, tmp_path: Path) -> None:
    """`make machine-faults` tries every phase."""
    draw, found = random.Random(job.axis), phases(job, tmp_path)
    outcomes = [
        one(job, draw.choice(found), fault, draw.choice(DELAYS), tmp_path) for fault in Fault
    ]
    assert [o for o in outcomes if o.wrong] == []
    assert sum(o.code is not None for o in outcomes) > len(Fault) // 2


def test_what_drops_without_energy_falls_freely_until_the_brake_holds(tmp_path: Path) -> None:
    """After STO: m*g less friction over J, for the 50 ms that the brake takes."""
    job = next(job for job in JOBS if job.axis == "vertical" and job.work == "identify")
    phases(job, tmp_path)
    outcome = one(job, "does the axis stay at rest?", Fault.STO, 0.06, tmp_path)
    load, coulomb, inertia, brake = 0.15, 0.08, 1e-4, 0.05
    assert outcome.drop == pytest.approx((load - coulomb) / inertia * brake**2 / 2, rel=0.1)
