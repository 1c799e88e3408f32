"""What a spoiled experiment gets: a reason, and no number that looks fine."""

from __future__ import annotations

import numpy as np
import pytest

from commissioning.identification.followed import (
    dwell_share,
    is_unsigned,
    of_torque,
    torque_gain,
)
from commissioning.identification.modulating import ModulatingEstimate, estimate
from commissioning.identification.reasons import Reason, Weight, verdict
from commissioning.identification.record import Record, rests
from commissioning.identification.verdict import (
    UnitNames,
    of_modulating,
    within_short,
)
from tests.identification.spoiled import COULOMB, SPOILED, changed, relay_tests


@pytest.fixture(scope="module")
def good() -> Record:
    return relay_tests()


def judged(record: Record) -> tuple[ModulatingEstimate, list[Reason]]:
    found = estimate(record)
    dwell = dwell_share(record, found.inertia.value, found.coulomb.value)
    swing = float(np.ptp(record.position)) / 4
    return found, [
        *of_modulating(found, UnitNames()),
        *of_torque(None, dwell, swing, record.resolution),
    ]


def test_a_sound_record_is_good_and_short_enough(good: Record) -> None:
    found, reasons = judged(good)
    assert verdict(reasons) == "good", reasons
    assert within_short(found)
    assert found.coulomb.value == pytest.approx(COULOMB, rel=2e-3)


@pytest.mark.parametrize("name", SPOILED)
def test_a_spoiled_record_is_found_out(good: Record, name: str) -> None:
    spoil, expected, words = SPOILED[name]
    found, reasons = judged(spoil(good))
    assert verdict(reasons) == expected, reasons
    assert any(words in reason.text for reason in reasons), reasons
    assert not within_short(found) or "counts" in words, "auto does not stop at a dozen periods"
    if expected == "usable":
        assert found.coulomb.low <= COULOMB <= found.coulomb.high, "and the interval still holds"


def test_a_record_that_is_too_short_or_constant_is_no_record(good: Record) -> None:
    with pytest.raises(ValueError, match="velocity reversals"):
        estimate(good.between(0.0, 0.1))
    with pytest.raises(ValueError, match="torque is constant"):
        estimate(changed(good, command=np.full_like(good.command, 0.2)))


def test_an_axis_that_sticks_at_its_reversals_is_seen() -> None:
    """A sine held for 30 ms at each extremum of a period of 0.3 s."""
    phase = np.arange(0, 6, 0.001) % 0.3
    turn = np.interp(phase, [0, 0.12, 0.15, 0.27, 0.3], [0, np.pi, np.pi, 2 * np.pi, 2 * np.pi])
    time = np.arange(0, 6, 0.001)
    position = np.round(0.3 * np.cos(turn) / 1e-4) * 1e-4
    record = Record.of(time, position, time, 0.3 * np.sign(np.sin(turn)), 1e-4)
    assert dwell_share(record, 1e-4, 0.1) == pytest.approx(2 * 0.03 / 0.3, rel=0.4)
    reasons = of_torque(None, 0.1, 1.0, 1e-4)
    assert reasons[0].weight is Weight.DOUBT
    assert "sticks" in reasons[0].text
    assert len(rests(record)) == pytest.approx(40, abs=2)


def test_the_torque_that_is_measured_must_be_the_torque_that_is_commanded() -> None:
    command = np.sign(np.sin(np.arange(2000) / 20)) * 0.3
    assert torque_gain(np.roll(command, 3), command) == pytest.approx(1.0, abs=0.02)
    assert torque_gain(0.6 * np.roll(command, 3), command) == pytest.approx(0.6, abs=0.02)
    # the drive is read after it has taken the next command already
    assert torque_gain(np.roll(command, -1), command) == pytest.approx(1.0, abs=0.02)
    assert torque_gain(np.full(2000, np.nan), command) is None
    assert of_torque(0.6, 0.0, 1.0, 1e-4)[0].weight is Weight.CONTRADICTION
    assert of_torque(0.88, 0.0, 1.0, 1e-4)[0].weight is Weight.DOUBT
    assert of_torque(1.02, 0.0, 1.0, 1e-4) == []


def test_the_worst_reason_makes_the_verdict() -> None:
    note, doubt, no = (Reason("", weight, "") for weight in Weight)
    assert verdict([]) == "good"
    assert verdict([note]) == "good"
    assert verdict([note, doubt]) == "usable"
    assert verdict([no, note]) == "rejected"


def test_a_torque_without_a_sign_is_measured_by_its_size() -> None:
    """A relay of ±0.5 N.m; AX2000's actual current has no sign."""
    command = np.where(np.arange(400) % 40 < 20, 0.5, -0.5)
    assert torque_gain(np.abs(command), command) == pytest.approx(1.0)
    assert torque_gain(0.8 * np.abs(command), command) == pytest.approx(0.8)
    assert is_unsigned(np.abs(command), command)
    for measured in (command, -command, np.zeros(400), np.full(400, np.nan)):
        assert not is_unsigned(measured, command)
    assert not is_unsigned(np.ones(400), np.ones(400)), "one way only says nothing"
    assert not is_unsigned(np.array([]), np.array([]))
