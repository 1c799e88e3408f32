"""Records that are not what they are taken for: each is told the reason that is true."""

from __future__ import annotations

import numpy as np
import pytest

from commissioning.identification.breaks import of_jumps
from commissioning.identification.errors import NotShown, words_of
from commissioning.identification.modulating import estimate
from commissioning.identification.reasons import Reason, Weight, verdict
from commissioning.identification.record import Record
from commissioning.identification.verdict import UnitNames, of_modulating
from tests.identification.spoiled import changed, relay_tests


@pytest.fixture(scope="module")
def good() -> Record:
    return relay_tests()


def judged(record: Record) -> list[Reason]:
    return [
        *of_modulating(estimate(record), UnitNames()), *of_jumps(record, "rad"),
    ]  # fmt: skip


def unexplained(record: Record) -> str:
    reasons = judged(record)
    assert verdict(reasons) != "good", reasons
    return next(reason.text for reason in reasons if reason.code == "fit.unexplained")


def joined(first: Record, second: Record) -> Record:
    """One record after the other, where both are at the same place."""
    shift = first.time[-1] + (first.time[-1] - first.time[-2])
    return Record.of(
        np.concatenate((first.time, second.time + shift)),
        np.concatenate((first.position, second.position)),
        np.concatenate((first.sent, second.sent + shift)),
        np.concatenate((first.command, second.command)),
        first.resolution,
    )


def test_a_sound_record_has_none_of_it(good: Record) -> None:
    assert of_jumps(good, "rad") == []
    (j1, f1), (j2, f2) = estimate(good).fit.parts
    assert j1 == pytest.approx(1e-3, rel=0.02)
    assert j2 == pytest.approx(1e-3, rel=0.02)
    assert f1 == pytest.approx(0.1, rel=0.05)
    assert f2 == pytest.approx(0.1, rel=0.05)


def test_a_record_of_two_axes() -> None:
    """Inertia 1e-3 and 2e-3, friction 0.1 and 0.07."""
    record = joined(relay_tests(), relay_tests({"inertia": "2e-3", "coulomb": "0.07"}))
    assert "a record of two axes" in unexplained(record)


def test_a_drive_that_clips_silently(good: Record) -> None:
    """The larger torque of ±0.32 is ±0.25 at the motor: what was recorded is what was sent."""
    loud = relay_tests(amplitudes=(0.18, 0.25))
    factor = np.where(np.abs(loud.command) > 0.2, 0.32 / 0.25, 1.0)
    text = unexplained(changed(loud, command=loud.command * factor))
    assert "does the drive limit it?" in text


def test_a_clock_that_runs_off(good: Record) -> None:
    """Stamps that come to count 20 % too much: 1.2² times the inertia, and the same friction."""
    middle = good.time[-1] / 2
    rate = np.where(good.time < middle, 1.0, 1.2)
    time = np.concatenate(([0.0], np.cumsum(np.diff(good.time) * rate[1:])))
    text = unexplained(changed(good, time=time, sent=time))
    assert "clock" in text


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_a_belt_that_jumps_a_tooth(good: Record, share: float) -> None:
    """0.1 rad, at once, while the axis goes on."""
    k = int(share * len(good.time))
    jumped = good.position + 0.1 * (np.arange(len(good.time)) > k)
    reasons = of_jumps(changed(good, position=jumped), "rad")
    assert [reason.code for reason in reasons] == ["position.jumps"]
    assert reasons[0].weight is Weight.CONTRADICTION
    step = jumped[k + 1] - jumped[k]
    assert f"jumps by {step:+.3g} rad at {good.time[k]:.3g} s" in reasons[0].text


def test_samples_that_were_lost_are_no_jump(good: Record) -> None:
    """Ten in a row: the axis went on for as long."""
    keep = np.ones(len(good.time), bool)
    keep[500:510] = False
    record = Record.of(
        good.time[keep], good.position[keep], good.sent, good.command, good.resolution
    )
    assert of_jumps(record, "rad") == []


def test_one_direction_only() -> None:
    time = np.arange(0, 4, 0.002)
    command = 0.2 + 0.05 * np.sign(np.sin(2 * np.pi * 2 * time))
    position = np.cumsum(np.cumsum(command - 0.1)) * 0.002**2 / 1e-3
    with pytest.raises(NotShown, match="one way only"):
        estimate(Record.of(time, position, time, command, 1e-4))


def test_a_library_s_failure_has_words_of_ours() -> None:
    assert words_of(NotShown("too short")) == "too short"
    for error in (np.linalg.LinAlgError("SVD did not converge"), ZeroDivisionError("x")):
        assert "SVD" not in words_of(error)
        assert "lead to no solution" in words_of(error)
