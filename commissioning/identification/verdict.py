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
from commissioning.identification.output_error import OutputErrorEstimate
from commissioning.identification.reasons import Reason, Weight

__all__ = [
    "UnitNames",
    "agreement",
    "as_wide_as_its_harmonics",
    "balance_is_better",
    "holding",
    "of_bend",
    "of_lock_in",
    "of_modulating",
    "of_output_error",
    "of_precision",
    "of_preference",
    "within_short",
]

Array = NDArray[np.float64]

# a short record is enough when these hold (method.md 3a)
_HALVES, _WIDTHS, _LEFT = 0.02, 0.05, 0.012
_BEYOND_NOISE = 1.5  # times what the resolution leaves

_REJECTED_LEFT = 0.12  # of the torque unexplained
_WIDE, _REJECTED_WIDTH = 0.04, 0.3  # half of f's interval, of f
_CONDITION = 200.0
_FEW_PERIODS, _WHOLE = 6.0, 0.1  # what is cut off at both ends is no period less
_MUCH_DRIFT = 0.1  # of the friction, over the record
_AGREE = 0.03  # of f
# of f, by which the balance's harmonics may differ: where it is preferred, and where nothing else
# is there; and what of that its interval holds
_HARMONICS, _OF_HARMONICS = (0.05, 0.15), 0.4
_PLAIN = 1.15  # colour of what is left where the motion itself is explained
_SPRING = 0.1  # of f, at a half-swing: a spring that may be the way to a load at rest
_BEND, _MOST_BEND = 2.0, 0.25  # of what positions and torques differ by in friction
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
        reasons.append(_impossible(f.value, found.inertia.value, e))
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


def _impossible(friction: float, inertia: float, effort: str) -> Reason:
    return Reason(
        "fit.impossible",
        Weight.CONTRADICTION,
        f"the fit gives a friction of {friction:.3g} {effort} and an inertia of {inertia:.3g}: no "
        "axis moves like this; is the torque's sign or unit wrong?",
    )


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
        reasons.append(_of_load(float(found.coefficients[law.place("load")])))
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
    reasons, law = [], found.law
    if law.drag:
        c = float(found.coefficients[law.place("drag")])
        reasons.append(_of_drag(c, found.peak_speed, units))
    if law.drift:
        rate = float(found.coefficients[law.place("drift")]) / found.coulomb.value
        reasons.append(_of_drift(rate, found.seconds))
    return reasons


def _of_drift(rate: float, seconds: float) -> Reason:
    """Friction that changes by a share of itself a second."""
    changed = abs(rate) * seconds
    return Reason(
        "law.drift",
        Weight.DOUBT if changed > _MUCH_DRIFT else Weight.NOTE,
        f"friction changed by {100 * rate:+.2f} % a second while it was measured, "
        f"{100 * changed:.1f} % in all: the number is the mean over the record",
    )


def of_output_error(found: OutputErrorEstimate, wanted: float, units: UnitNames) -> list[Reason]:
    """Reasons that output error gives; `wanted`: half of the interval, of the friction."""
    reasons: list[Reason] = []
    f, e = found.coulomb, units.effort

    def add(code: str, weight: Weight, text: str) -> None:
        reasons.append(Reason(code, weight, text))

    if not f.high > 0 or not found.inertia.high > 0:
        reasons.append(_impossible(f.value, found.inertia.value, e))
        return reasons
    if not found.is_explained:
        add(
            "positions.unexplained",
            Weight.CONTRADICTION,
            "friction that falls with the speed would explain the positions as well (--method auto "
            "looks for it)"
            if found.bends
            else "the positions are those of a motor that winds up a spring, behind which the load "
            "stands still; more --max-torque moves it"
            if found.colour < _PLAIN and "spring" in found.terms
            else f"a rigid axis leaves {100 * found.misfit:.2g} % of the friction unexplained in "
            "the positions: the axis is elastic, or its friction is of another kind (--method auto "
            "looks for it)",
        )
    if found.is_explained:
        reasons += of_precision(f, round(found.periods), wanted)
    return [*reasons, *_of_interval(f, e), *_of_terms(found, units)]


def of_precision(f: Estimate, periods: int, wanted: float) -> list[Reason]:
    """That an interval is wider than was asked for, and no doubt for that."""
    if not _WIDE >= f.half_width > wanted:
        return []
    return [
        Reason(
            "interval.asked",
            Weight.NOTE,
            f"the friction is known to ±{100 * f.half_width:.2g} % after {periods} periods, "
            f"±{100 * wanted:.2g} % were asked for: more are not run, and less than ±0.03 % is not "
            "told; more --travel helps",
        )
    ]


def holding(f: Estimate, level: float) -> Estimate:
    """The number with an interval that holds the level of a curve, and as much again in doubt."""
    reach = min(_BEND * abs(f.value - level), _MOST_BEND * abs(f.value))
    return Estimate(f.value, min(f.low, f.value - reach), max(f.high, f.value + reach))


def of_bend(units: UnitNames) -> Reason:
    """Of positions that a Stribeck curve would explain, where the torques need none."""
    return Reason(
        "law.bends",
        Weight.DOUBT,
        "the positions show friction that falls with the speed, of which the torques do not tell "
        f"enough to give it in {units.effort}: at higher speeds it may be less; more --travel "
        "shows it",
    )


def _of_terms(found: OutputErrorEstimate, units: UnitNames) -> list[Reason]:
    """What the terms of the law say that explains the positions."""
    e, p, size, f = units.effort, units.position, found.size, found.coulomb.value
    reasons = []
    if "drag" in found.terms:
        reasons.append(_of_drag(size("drag"), found.peak_speed, units))
    if "load" in found.terms:
        reasons.append(_of_load(size("load")))
    if "drift" in found.terms:
        reasons.append(_of_drift(size("drift"), found.seconds))
    if "spring" in found.terms:
        reasons.append(
            Reason(
                "law.spring",
                Weight.DOUBT if size("spring") * found.half_swing > _SPRING * f else Weight.NOTE,
                f"a torque goes with the position as that of a spring of {size('spring'):.3g} "
                f"{e}/{p}: the offset is that of the middle of the motion. It may be what the "
                "motor winds up while the load stands still: then this is the motor's friction "
                "alone, and more --max-torque moves the load",
            )
        )
    if "eccentricity" in found.terms:
        reasons.append(
            Reason(
                "law.eccentricity",
                Weight.NOTE,
                f"the encoder is eccentric, by up to {size('eccentricity'):.2g} {p} a turn; the "
                "numbers are without it",
            )
        )
    return reasons


def _of_drag(factor: float, peak_speed: float, units: UnitNames) -> Reason:
    e, p = units.effort, units.position
    return Reason(
        "law.drag",
        Weight.NOTE,
        f"drag: a torque that grows with the square of the speed, {factor:.3g} {e}·s²/{p}² or "
        f"{factor * peak_speed**2:.3g} {e} at the fastest; the friction is that without it",
    )


def _of_load(share: float) -> Reason:
    return Reason(
        "law.load",
        Weight.NOTE,
        f"friction grows with the torque, by {100 * share:.1f} % of it: the level is that without "
        "load",
    )


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
