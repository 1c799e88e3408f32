"""The path that an axis follows in position mode.

Where it begins, and what may not be tried again.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from commissioning.envelope import Envelope
from commissioning.errors import EnvelopeTripped, FeedbackReversed, MeasurementRejected
from commissioning.experiments.plan import Context
from commissioning.experiments.tracking import TrackingPath, track
from commissioning.rig.ready import Ready
from drivers.sample import Sample, Status

OK = Status(enabled=True, fault=False, stopping=False, limit=False, word=0x27)
CYCLE, START = 0.001, 2.0
CONTEXT = Context(
    cycle=CYCLE, resolution=1e-5, start=START, travel=0.5, torque=0.8, speed=3.1,
)  # fmt: skip
PATH = TrackingPath(amplitude=0.1, period=2.0, creep=0.005)


def followed(here: float) -> list[float]:
    """Every command, to an axis that follows at once."""
    plan, commands, time = track(CONTEXT, PATH, here), [], 0.0
    command = next(plan)
    while True:
        commands.append(command)
        time += CYCLE
        try:
            command = plan.send(Sample(time, command, 0.0, command, time, OK, 0.0, 0))
        except StopIteration:
            return commands


@pytest.mark.parametrize("off", [0.004, -0.004, 0.0, 0.05])
def test_an_axis_that_friction_holds_a_little_off_is_fetched_without_a_step(off: float) -> None:
    commands = followed(START + off)
    watch = Envelope(
        centre=START, travel=0.5, speed=3.1, torque=0.8, duration=600.0, cycle=CYCLE
    ).watch(START + off)
    for command in commands:
        watch.admit_position(command)
    first = next(n for n, command in enumerate([START + off, *commands]) if command == START)
    slowly = PATH.amplitude / (PATH.period / CYCLE)
    assert first == pytest.approx(abs(off) / slowly, abs=1)
    assert commands[-1] == START


@pytest.mark.parametrize(
    ("error", "becomes"),
    [
        (EnvelopeTripped("travel"), MeasurementRejected),
        (FeedbackReversed("turned"), FeedbackReversed),
    ],
)
def test_an_encoder_that_turned_is_not_tried_once_more(
    error: EnvelopeTripped, becomes: type[Exception]
) -> None:
    def fails(plan: Any) -> None:
        raise error

    job = SimpleNamespace(run=fails, mover=SimpleNamespace(is_energised=False))
    with pytest.raises(becomes):
        Ready.attempt(job, None)  # type: ignore[arg-type]
