"""How far a measurement can be trusted, and why not further.

Each reason has a weight: a note changes nothing, a doubt makes the result `usable`, a contradiction
makes it `rejected`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from commissioning.identification.breaks import what_changed
from commissioning.identification.estimate import Estimate
from commissioning.identification.lock_in import LockIn
from commissioning.identification.modulating import SUSPICIOUS, ModulatingEstimate
from commissioning.identification.reasons import Reason, Weight
from commissioning.identification.record import Record, reversals

__all__ = [
    "UnitNames",
    "agreement",
    "as_wide_as_its_harmonics",
    "balance_is_better",
    "dwell_share",
    "is_unsigned",
    "of_lock_in",
    "of_modulating",
    "of_preference",
    "of_torque",
    "torque_gain",
    "within_short",
]

Array = NDArray[np.float64]

# a short record is enough when these hold (method.md 3a)
_HALVES, _WIDTHS, _LEFT = 0.02, 0.05, 0.012
_BEYOND_NOISE = 1.5  # times what the resolution leaves

_REJECTED_LEFT = 0.12  # of the torque unexplained
_WIDE, _REJECTED_WIDTH = 0.04, 0.3  # half of f's interval, of f
_COARSE, _TOO_COARSE = 150, 30  # counts of half-swing
_DWELL, _MUCH_DWELL = 0.02, 0.15  # of the time
_TORQUE_OFF = 0.08  # of the command
_CONDITION = 200.0
_FEW_PERIODS, _WHOLE = 6.0, 0.1  # what is cut off at both ends is no period less
_MUCH_DRIFT = 0.1  # of the friction, over the record
_AGREE = 0.03  # of f
# of f, by which the balance's harmonics may differ: where it is preferred, and where nothing else
# is there; and what of that its interval holds
_HARMONICS, _OF_HARMONICS = (0.05, 0.15), 0.4
_BEHIND = 0.03  # of f


@dataclass(frozen=True, slots=True)
class UnitNames:
    """Names of the units for messages."""

    position: str = "rad"
    effort: str = "N.m"


def within_short(found: ModulatingEstimate) -> bool:
    """Whether a dozen periods are enough.

    One number, whichever part and frequency it is taken from.
    """
    return (
        not found.law.rungs
        and found.rigid_residual <= max(_LEFT, _BEYOND_NOISE * found.noise)
        and found.halves <= max(_HALVES, found.noise)
        and found.widths <= max(_WIDTHS, 2 * found.noise)
        and found.lateness <= SUSPICIOUS
        and found.coulomb.value > 0
    )


def of_modulating(found: ModulatingEstimate, units: UnitNames) -> list[Reason]:
    """Reasons that the fit itself gives."""
    reasons: list[Reason] = []
    e = units.effort

    def add(code: str, weight: Weight, text: str) -> None:
        reasons.append(Reason(code, weight, text))

    f = found.coulomb
    left = found.held_out
    if not f.value > 0 or not found.inertia.high > 0:
        add(
            "fit.impossible",
            Weight.CONTRADICTION,
            f"the fit gives a friction of {f.value:.3g} {e} and an inertia of "
            f"{found.inertia.value:.3g}: no axis moves like this; is the torque's sign or unit "
            "wrong?",
        )
        return reasons
    if left > max(_REJECTED_LEFT, 3 * found.noise):
        add(
            "fit.unexplained",
            Weight.CONTRADICTION,
            f"the equation of motion leaves {100 * left:.0f} % of the torque unexplained: "
            + (
                what_changed(found.fit.parts, found.widths > _WIDTHS, units.effort)
                or "the axis is elastic or has play, is moved by something else, or torque and "
                "position do not belong together"
            ),
        )
    elif left > max(_LEFT, _BEYOND_NOISE * found.noise):
        add(
            "fit.unexplained",
            Weight.DOUBT,
            f"{100 * left:.1f} % of the torque is unexplained: "
            + (
                what_changed(found.fit.parts, found.widths > _WIDTHS, units.effort)
                or "wide and narrow windows differ, so the axis is elastic or has play"
                if found.widths > _WIDTHS
                else "the friction is not Coulomb-like, or the axis is elastic"
            ),
        )
    if found.lateness > SUSPICIOUS:
        add(
            "fit.reversals",
            Weight.DOUBT,
            f"the reversals that fit best lie {100 * found.lateness:.0f} % of a sample from zero "
            "velocity: the friction law is incomplete, or the link too irregular for the period; a "
            "shorter --cycle or a longer period helps",
        )
    return [*reasons, *_of_interval(f, e), *_of_record(found), *_of_law(found, units)]


def _of_interval(f: Estimate, effort: str) -> list[Reason]:
    """How wide it is."""
    told = f"{f.low:.3g} … {f.high:.3g} {effort}"
    if f.half_width > _REJECTED_WIDTH:
        text = (
            f"the interval of the friction, {told}, is too wide to be of use: give the axis more "
            "torque, travel or periods"
        )
        return [Reason("interval.wide", Weight.CONTRADICTION, text)]
    if f.half_width > _WIDE:
        text = f"the interval of the friction is wide: {told}"
        return [Reason("interval.wide", Weight.DOUBT, text)]
    return []


def _of_record(found: ModulatingEstimate) -> list[Reason]:
    """What the record says about itself: too few periods, too coarse, too alike."""
    reasons: list[Reason] = []

    def add(code: str, weight: Weight, text: str) -> None:
        reasons.append(Reason(code, weight, text))

    if found.halves > max(_HALVES, 2 * found.noise):
        add(
            "periods.differ",
            Weight.DOUBT,
            f"odd and even periods differ by {100 * found.halves:.1f} % in friction: the axis "
            "changes while it is measured",
        )
    if found.condition > _CONDITION:
        add(
            "coulomb-viscous",
            Weight.DOUBT,
            "the record hardly tells Coulomb from viscous friction (condition "
            f"{found.condition:.0f}): two oscillations of clearly different torque are needed",
        )
    if found.periods < _FEW_PERIODS - _WHOLE:
        add(
            "periods.few",
            Weight.DOUBT,
            f"only {found.periods:.1f} periods; {_FEW_PERIODS:g} are few enough",
        )
    if found.noise > 0.03:
        add(
            "position.coarse",
            Weight.DOUBT,
            f"the position is coarse for this swing: its resolution alone hides "
            f"{100 * found.noise:.0f} % of the torque; a longer period or more travel helps",
        )
    return reasons


def _of_law(found: ModulatingEstimate, units: UnitNames) -> list[Reason]:
    """What the friction law that was needed says."""
    reasons: list[Reason] = []
    e, p, law = units.effort, units.position, found.law

    def add(code: str, weight: Weight, text: str) -> None:
        reasons.append(Reason(code, weight, text))

    if law.stribeck is not None:
        add(
            "law.stribeck",
            Weight.NOTE,
            f"Stribeck effect: friction falls from about {found.low_speed:.3g} {e} at rest to "
            f"{found.coulomb.value:.3g} {e} beyond {law.stribeck:.3g} {p}/s"
            + (
                "; below that speed the tests were too fast to say more"
                if found.peak_speed > 15 * law.stribeck
                else ""
            ),
        )
    if law.soft is not None:
        add(
            "law.soft",
            Weight.DOUBT,
            f"soft friction: it rises over {law.soft:.3g} {p}/s to its level instead of switching "
            "with the sign; compensation by the sign alone does too much at low speed",
        )
    if law.load:
        c = float(found.coefficients[law.place("load")])
        add(
            "law.load",
            Weight.NOTE,
            f"friction grows with the torque, by {100 * c:.1f} % of it: the level is that without "
            "load",
        )
    reasons += _of_small_terms(found, units)
    if law.position is not None:
        size = float(np.hypot(*found.coefficients[-2:]))
        add(
            "law.position",
            Weight.DOUBT,
            f"position-dependent torque of ±{size:.3g} {e} with a pitch of {law.position:.4g} {p}: "
            "cogging or the wobble of a screw or gear",
        )
    return reasons


def _of_small_terms(found: ModulatingEstimate, units: UnitNames) -> list[Reason]:
    """What the terms beside friction say: drag, and drift."""
    reasons = []
    e, p, law = units.effort, units.position, found.law
    if law.drag:
        c = float(found.coefficients[law.place("drag")])
        reasons.append(
            Reason(
                "law.drag",
                Weight.NOTE,
                f"drag: a torque that grows with the square of the speed, {c:.3g} {e}·s²/{p}² or "
                f"{c * found.peak_speed**2:.3g} {e} at the fastest; the friction is that without "
                "it",
            )
        )
    if law.drift:
        rate = float(found.coefficients[law.place("drift")]) / found.coulomb.value
        changed = abs(rate) * found.seconds
        reasons.append(
            Reason(
                "law.drift",
                Weight.DOUBT if changed > _MUCH_DRIFT else Weight.NOTE,
                f"friction changed by {100 * rate:+.2f} % a second while it was measured, "
                f"{100 * changed:.1f} % in all: the number is the mean over the record",
            )
        )
    return reasons


def of_lock_in(found: LockIn, resolution: float, units: UnitNames) -> list[Reason]:
    """Reasons that the exact balance gives."""
    reasons = []
    f = found.coulomb.value
    third = found.harmonics[1] / f - 1 if f else 0.0
    noise = 40 * resolution / min(found.half_swing)  # harmonic 3 is a ninth or less of the first
    if abs(third) > max(0.08, noise):
        reasons.append(
            Reason(
                "balance.harmonics",
                Weight.DOUBT,
                f"harmonic 3 of the balance gives a friction {100 * third:+.0f} % from the "
                "fundamental's: the axis is elastic, or its friction is not Coulomb-like",
            )
        )
    if f and found.coulomb.half_width > _REJECTED_WIDTH:
        reasons.append(
            Reason(
                "interval.wide",
                Weight.CONTRADICTION,
                f"the balance gives {found.coulomb.low:.3g} … {found.coulomb.high:.3g} "
                f"{units.effort}: its periods differ too much to say more",
            )
        )
    if sum(found.rejected):
        reasons.append(
            Reason(
                "balance.left-out",
                Weight.NOTE,
                f"{sum(found.rejected)} of {sum(found.periods) + sum(found.rejected)} periods were "
                "left out: they do not obey the balance of the others (late or lost cycles)",
            )
        )
    return reasons


def agreement(fast: ModulatingEstimate, exact: LockIn, units: UnitNames) -> Reason:
    """Modulating functions against the exact balance."""
    a, b = fast.coulomb, exact.coulomb
    apart = abs(a.value - b.value)
    allowed = max((a.high - a.low + b.high - b.low) / 2, _AGREE * abs(a.value))
    told = (
        f"modulating functions give {a.value:.4g} {units.effort}, the exact balance "
        f"{b.value:.4g} {units.effort}"
    )
    if apart <= allowed:
        return Reason("methods.agree", Weight.NOTE, f"{told}: they agree")
    if fast.law.rungs:
        return Reason(
            "methods.agree",
            Weight.NOTE,
            f"{told}: the balance means over the torques and speeds of its tests, the law above "
            "says how friction goes with them",
        )
    return Reason(
        "methods.agree",
        Weight.DOUBT,
        f"{told}: they disagree, so the axis is not rigid with Coulomb friction",
    )


def balance_is_better(fast: ModulatingEstimate, exact: LockIn) -> bool:
    """Whether the exact balance explains what modulating functions do not.

    It asks for nothing but friction on the measured side of a linear plant, which may be elastic;
    that its harmonics agree shows it (method.md 9.5). On bristles they do not.
    """
    if not exact.coulomb.value > 0 or exact.apart > _HARMONICS[1]:
        return False
    wide = as_wide_as_its_harmonics(exact).coulomb.half_width
    if exact.apart > _HARMONICS[0]:  # only where there is no other number
        left = fast.held_out > max(_REJECTED_LEFT, 3 * fast.noise)
        return left or fast.coulomb.half_width > max(_REJECTED_WIDTH, 2 * wide)
    # on bristles the harmonics may agree by chance, but there a law leaves little
    left = fast.held_out > max(_LEFT, _BEYOND_NOISE * fast.noise)
    return left and wide < fast.coulomb.half_width


def as_wide_as_its_harmonics(exact: LockIn) -> LockIn:
    """The balance with an interval that holds a share of what its harmonics differ by.

    And, behind a spring that the record shows, of a friction that is not on the measured side.
    """
    f = exact.coulomb
    more = (_OF_HARMONICS * exact.apart + (_BEHIND if exact.elastic else 0.0)) * f.value
    return replace(exact, coulomb=Estimate(f.value, f.low - more, f.high + more))


def of_preference(fast: ModulatingEstimate, exact: LockIn, units: UnitNames) -> Reason:
    """Why the balance gives the number."""
    return Reason(
        "balance.preferred",
        Weight.DOUBT
        if exact.apart > _HARMONICS[0] or exact.elastic or exact.coulomb.half_width > _WIDE
        else Weight.NOTE,
        "the number is the exact balance's, which needs no rigid axis: its harmonics agree to "
        f"{100 * exact.apart:.1f} %; the equation of motion of a rigid axis leaves "
        f"{100 * fast.held_out:.1f} % of the torque unexplained and gives "
        f"{fast.coulomb.value:.4g} {units.effort}",
    )


def of_torque(
    gain: float | None, dwell: float, half_swing: float, resolution: float
) -> list[Reason]:
    """Reasons that the raw record gives: torque followed, rests, counts (half-swing in counts)."""
    reasons = []
    if gain is not None and abs(gain - 1) > _TORQUE_OFF:
        weight = Weight.CONTRADICTION if abs(gain - 1) > 0.3 else Weight.DOUBT
        reasons.append(
            Reason(
                "torque.scale",
                weight,
                f"the drive measures {100 * gain:.0f} % of the torque that is commanded: it "
                "limits, or its torque scale is wrong",
            )
        )
    if dwell > _DWELL:
        weight = Weight.CONTRADICTION if dwell > _MUCH_DWELL else Weight.DOUBT
        reasons.append(
            Reason(
                "axis.sticks",
                weight,
                f"the axis rests at its reversals for {100 * dwell:.0f} % of the time: it sticks; "
                "a larger torque (--max-torque) takes it through",
            )
        )
    counts = half_swing / resolution if resolution else np.inf
    if counts < _COARSE:
        reasons.append(
            Reason(
                "position.coarse",
                Weight.CONTRADICTION if counts < _TOO_COARSE else Weight.DOUBT,
                f"the smaller oscillation has a half-swing of {counts:.0f} encoder counts; "
                f"{_COARSE} are needed for a fine result: give more --travel",
            )
        )
    return reasons


def dwell_share(record: Record, inertia: float, coulomb: float) -> float:
    """Share of the time that the axis rests at its reversals, beyond what turning takes."""
    y, t = record.position, record.time
    instants, _ = reversals(record)
    if not len(instants) or not inertia > 0:
        return 0.0
    swing = record.command - np.median(record.command)
    pull = max(float(np.quantile(np.abs(swing), 0.5)) - coulomb, 0.1 * coulomb)
    reach = 1.5 * max(record.resolution, 1e-6 * float(np.ptp(y)))
    step = float(np.median(np.diff(t)))
    turning = 2 * np.sqrt(2 * reach * inertia / pull) + 3 * step
    rested = 0.0
    for at in np.searchsorted(t, instants):
        k = min(max(int(at), 0), len(y) - 1)
        first = last = k
        while first > 0 and abs(y[first - 1] - y[k]) <= reach:
            first -= 1
        while last < len(y) - 1 and abs(y[last + 1] - y[k]) <= reach:
            last += 1
        rested += max(t[last] - t[first] - turning, 0.0)
    return float(rested / (t[-1] - t[0]))


_AHEAD = 2  # cycles
_A_PUSH = 0.05  # of the largest command


def is_unsigned(measured: Array, command: Array) -> bool:
    """Whether a drive tells its torque without a sign.

    A command that pushes both ways, and never below zero.

    Parameters
    ----------
    measured, command : (n,) N.m or N, one a cycle
    """
    least = _A_PUSH * float(np.abs(command).max(initial=0.0))
    pushes_both_ways = min(-command.min(initial=0.0), command.max(initial=0.0)) > least
    return bool(
        pushes_both_ways
        and measured.min(initial=0.0) > -least
        and measured.max(initial=0.0) > least
    )


def torque_gain(measured: Array, command: Array) -> float | None:
    """Measured torque over commanded, at the lag that fits best; None where nothing is measured.

    A drive that always tells 0 measures nothing.

    Of a torque without a sign: mean size over mean size.

    A drive that is read some time after it was commanded shows the torque before the command is
    said to be in force: the lag may be a cycle or two the other way.

    Parameters
    ----------
    measured, command : (n,) N.m or N, one a cycle
    """
    if not np.isfinite(measured).all() or len(measured) < 50 or not np.any(measured):
        return None
    if is_unsigned(measured, command):
        return float(np.abs(measured).mean() / max(np.abs(command).mean(), 1e-300))
    m, c = measured - measured.mean(), command - command.mean()
    gains, misses = [], []
    for lag in range(-_AHEAD, min(40, len(c) // 8)):
        a, b = (m[lag:], c[: len(c) - lag]) if lag >= 0 else (m[:lag], c[-lag:])
        gain = float(a @ b) / max(float(b @ b), 1e-300)
        gains.append(gain)
        misses.append(float(np.mean((a - gain * b) ** 2)))
    return gains[int(np.argmin(misses))]
