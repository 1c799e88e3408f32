"""A point of the plant read from oscillations with friction,
against the plant that was simulated."""

from __future__ import annotations

import numpy as np
import pytest

from commissioning.identification.modulating import estimate
from commissioning.identification.reading import Explained, Reader
from commissioning.identification.record import Record
from drivers.virtual.plant import Plant, PlantParameters

J, F, TAU, CYCLE = 1e-3, 0.1, 0.002, 0.001


def oscillate(viscous: float, stretches: list[tuple[float, float, float]]) -> Record:
    """Square waves of (amplitude, period, duration) one after the other, delayed by TAU,
    from rest."""
    plant = Plant(PlantParameters(J, viscous, F, F))
    rows, now, command = [], 0.0, 0.0
    commands = [0.0] * round(TAU / CYCLE)
    for amplitude, period, duration in stretches:
        for n in range(round(duration / CYCLE)):
            phase = (n * CYCLE / period + 0.2) % 1
            command = amplitude if phase < 0.5 else -amplitude
            rows.append((now, plant.position, command))
            commands.append(command)
            plant.advance(CYCLE, commands.pop(0))
            now += CYCLE
    time, position, sent = np.array(rows).T
    return Record.of(time, position, time, sent, 1e-7)


def plant_at(period: float, viscous: float) -> complex:
    s = 2j * np.pi / period
    return complex(np.exp(-s * TAU) / (J * s**2 + viscous * s))


@pytest.fixture(scope="module", params=[2e-3, 0.03], ids=["little damping", "much damping"])
def known(request: pytest.FixtureRequest) -> tuple[float, Explained]:
    record = oscillate(request.param, [(0.2, 0.1, 0.5), (0.35, 0.1, 0.7)])
    found = Explained.of(estimate(record))
    assert found is not None
    return request.param, found


def test_one_period_that_does_not_close_gives_the_plant(
    known: tuple[float, Explained],
) -> None:
    viscous, law = known
    record = oscillate(viscous, [(0.2, 0.1, 0.5), (0.35, 0.1, 0.7)])
    reader = Reader(record, law, 0.1)
    for begin in (0.13, 0.52, 0.61):  # from rest, and across the change of the amplitude
        point = reader.point(begin, 0.1, 1)
        assert point.value == pytest.approx(plant_at(0.1, viscous), rel=0.01)
        assert point.measured


@pytest.mark.parametrize("period", [0.06, 0.25])
def test_a_law_that_is_known_reads_another_record_at_another_period(
    known: tuple[float, Explained], period: float
) -> None:
    viscous, law = known
    record = oscillate(viscous, [(0.3, period, 12 * period)])
    point = Reader(record, law, period).point(3.3 * period, period, 8)
    truth = plant_at(period, viscous)
    assert point.value == pytest.approx(truth, rel=5e-3)
    assert point.gain_error is not None
    assert point.phase_error is not None
    assert abs(point.gain / abs(truth) - 1) <= point.gain_error
    assert abs(np.degrees(np.angle(point.value / truth))) <= point.phase_error


def test_a_record_without_reversals_is_refused(known: tuple[float, Explained]) -> None:
    time = np.arange(200) * CYCLE
    record = Record.of(time, 3 * time, time, np.zeros_like(time), 1e-7)
    with pytest.raises(ValueError, match="0 velocity reversals"):
        Reader(record, known[1], 0.1)
