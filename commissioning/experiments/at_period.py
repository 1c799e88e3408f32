"""An oscillation at a period that is given: the plant is wanted at that frequency."""

from __future__ import annotations

from dataclasses import dataclass

from commissioning.experiments.approach import approach
from commissioning.experiments.first_look import FirstLook
from commissioning.experiments.oscillator import Held, Oscillator, hold, stop_at_reversal
from commissioning.experiments.plan import Context, Plan, come_to_rest

__all__ = ["Wanted", "oscillate_at"]

_MEASURE, _MOST = 6, 18  # periods: settled, and at most


@dataclass(frozen=True, slots=True)
class Wanted:
    """One oscillation.

    Attributes
    ----------
    period : s
    amplitude : d, half of the torque's swing, N.m or N
    half_swing : of the position, as the model promises it, rad or m
    gain : |position/torque| there, by the model, rad/(N.m) or m/N
    bias : N.m or N
    most : largest torque about the bias, N.m or N
    """

    period: float
    amplitude: float
    half_swing: float
    gain: float
    bias: float
    most: float


def oscillate_at(context: Context, known: FirstLook, wanted: Wanted) -> Plan[tuple[Held, float]]:
    """The oscillation until it repeats and some periods more.

    Also the instant where its record ends, s.

    It begins at rest where it will turn, with the torque at the phase that a turn has, so that
    hardly a transient is to be waited for.
    """
    yield from approach(context, context.start - wanted.half_swing, known)
    sample = yield wanted.bias
    d = wanted.amplitude
    friction = min(known.coulomb, 0.9 * d)
    centre = sample.position + wanted.half_swing
    oscillator = Oscillator(
        d, wanted.period, centre, wanted.bias, gain=wanted.gain, cycle=context.cycle,
        most=wanted.most, lead=(d - friction) / (4 * d),
    )  # fmt: skip
    held, sample = yield from hold(context, oscillator, sample, _MEASURE, _MOST)
    end = sample.time
    yield from stop_at_reversal(oscillator.torque, sample, wanted.bias, 2 * wanted.period)
    yield from come_to_rest(wanted.bias, context)
    return held, end
