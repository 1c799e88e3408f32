"""Relay tests of the thesis from a computer that stalls, on an axis that is integrated here."""

from __future__ import annotations

import random
import subprocess
import sys
from math import pi
from pathlib import Path

import pytest

from commissioning.experiments.design import RelayDesign
from commissioning.experiments.first_look import FirstLook
from commissioning.experiments.plan import Context
from commissioning.experiments.two_relay import TwoRelay, two_relay
from commissioning.identification.two_relay import from_cycles
from drivers.sample import Sample, Status
from tests.command import ROOT

INERTIA, FRICTION = 1e-3, 0.1  # kg.m2, N.m
DELAY, CYCLE, COUNT = 0.002, 0.004, 2 * pi / 100_000  # s, s, rad
STEP = 5e-5  # s
STATUS = Status(enabled=True, fault=False, stopping=False, limit=False, word=0)
D1, PERIOD = 0.17, 0.2  # N.m, s


class Axis:
    """J·dv/dt = u − f·sign(v), with a dead time, and at rest until the torque exceeds f."""

    def __init__(self) -> None:
        self.time = self.position = self.velocity = self.before = 0.0

    def run(self, torque: float, steps: int) -> Sample:
        for step in range(steps):
            u = torque if step * STEP >= DELAY else self.before
            v = self.velocity
            if v == 0 and abs(u) <= FRICTION:
                faster = 0.0
            else:
                against = FRICTION if (v or u) > 0 else -FRICTION
                faster = v + (u - against) / INERTIA * STEP
                if faster * v < 0:
                    faster = 0.0
            self.position += 0.5 * (v + faster) * STEP
            self.velocity = faster
            self.time += STEP
        self.before = torque
        position = round(self.position / COUNT) * COUNT
        return Sample(self.time, position, 0.0, torque, self.time, STATUS, 0.0, 0)


def run(stalls: float, longest: float, seed: int) -> TwoRelay:
    """Both tests; this share of the cycles takes up to `longest` s more."""
    draw, axis = random.Random(seed), Axis()
    context = Context(CYCLE, COUNT, 0.0, 20.0, 1.0, 200.0)
    known = FirstLook(FRICTION, 0.0, FRICTION, 1e-5, INERTIA, DELAY + CYCLE)
    swing = PERIOD**2 * (D1**2 - FRICTION**2) / (32 * INERTIA * D1)
    plan = two_relay(context, RelayDesign(D1, 1.8 * D1, 0.4, 0.02, PERIOD, swing, 10.0, 0.0), known)
    torque = next(plan)
    while True:
        late = draw.uniform(0.3, 1.0) * longest if draw.random() < stalls else 0.0
        try:
            torque = plan.send(axis.run(torque, round((CYCLE + late) / STEP)))
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("stalls", "longest"), [(0.003, 0.02), (0.01, 0.02), (0.003, 0.06)])
def test_periods_that_a_stall_disturbs_are_left_out(
    stalls: float, longest: float, seed: int
) -> None:
    """Averaged with the others, they put the friction off by up to 20 %."""
    found = run(stalls, longest, seed)
    coulomb = from_cycles(found.first, found.second, CYCLE).coulomb
    assert coulomb.value == pytest.approx(FRICTION, rel=0.06)
    assert coulomb.low <= FRICTION <= coulomb.high


def test_a_link_that_is_hardly_ever_on_time_gets_a_mean() -> None:
    found = run(0.05, 0.008, 1)
    coulomb = from_cycles(found.first, found.second, CYCLE).coulomb
    assert coulomb.low <= FRICTION <= coulomb.high


WATCHED = """
import sys
from pathlib import Path
from commissioning import runner
from commissioning.interruption import Interruption
from commissioning.journal import Journal
from commissioning.rig import mover
from commissioning.desk import Desk, Options
from commissioning.session.identify import identify
from commissioning.session.verify import Wishes, verify
from drivers.link import axis_of

def run(*words, **named):
    before = set(sys.modules)
    try:
        return runner.run(*words, **named)
    finally:
        print(*sorted(set(sys.modules) - before))

mover.run = run
with Journal(Path(sys.argv[1])) as journal, Interruption() as interruption:
    desk = Desk(journal, interruption, lambda text: None, lambda question, word: True)
    identify(axis_of("virtual://bench"), Options(cycle=0.004, method="all"), desk)
    verify("last", None, desk, Wishes())
"""


def test_nothing_is_imported_in_a_cycle(tmp_path: Path) -> None:
    """np.median imports numpy.ma when it is called first.

    80 ms and more on a busy laptop, in motion.
    """
    done = subprocess.run(
        [sys.executable, "-c", WATCHED, str(tmp_path)],
        capture_output=True, text=True, cwd=ROOT, timeout=150, check=True,
    )  # fmt: skip
    assert len(done.stdout.splitlines()) > 10
    assert done.stdout.split() == []
