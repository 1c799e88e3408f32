"""Friction, inertia and dead time by modulating functions: no settling, no period, no derivative.

For a rigid axis  J·ÿ + B·ẏ = u(t−τ) − F − offset  is multiplied by a φ that vanishes with its first
derivatives at both ends of a window, and integrated by parts (Shinbrot 1957; Preisig and Rippin
1993; method.md 3a):

    J·∫φ''·y − B·∫φ'·y + f·∫φ·sign(ẏ) + offset·∫φ = ∫φ·u(t−τ)

φ is sin⁴ at the samples and straight between them. For such a φ the integrals are sums of hat
moments (`signals`), exact at any sampling: late cycles and lost samples are nothing special. Many
windows of two widths make a linear least-squares problem; τ joins it by its derivative. Velocity,
reversals and ∫y between the samples come from the model itself (`motion`) and are improved from
pass to pass.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from commissioning.identification.estimate import Estimate
from commissioning.identification.fitting import Fit, Fitter
from commissioning.identification.friction_laws import Law, Rung, curve
from commissioning.identification.record import Kinematics, Record, kinematics, rests

__all__ = ["EXPLAINS", "SUSPICIOUS", "ModulatingEstimate", "estimate", "refined_kinematics"]

Array = NDArray[np.float64]

_NARROWER, _FEW_SAMPLES = 0.4, 60  # any motion: each width of the last, down to this many samples
# the ladder: a richer law must explain held-out periods better by this factor
_BETTER, _BETTER_THAN_SUSPICIOUS = 0.6, 0.9
SUSPICIOUS = 0.08  # of a sample: reversals so far from zero velocity make up for an incomplete law
# share of the torque below which nothing is left that one more term could explain, a second one
# more
_EXPLAINED = 1e-3, 3e-3
EXPLAINS = 0.03  # of the torque: a model that leaves more says nothing about reversals
_EXPLAINED_BY_DRIFT = 0.02  # of the torque: what is left more is a change, and no drift
_NEARLY_EXPLAINED = 5e-3  # of the torque: below, a small term is no make-up for another law
_LINEAR: tuple[Rung, ...] = ("drift", "drag")
_AS_GOOD = 1.2  # times the least held-out residual: a shape that the record does not tell apart
_REACHED = 1.5  # of the slope that a sigmoid still has at the peak speed
# what reversals that are late take or give, by their share of a period: a sign that is late is
# friction in phase with the acceleration
_LATE_INERTIA, _LATE_VISCOUS, _LATE = 3.0, 3.0, 1.0
_A_LAW = 0.5  # of the torque that is left beyond the noise
_LOADED = 0.004  # of J and f: a lag of the torque, where friction goes with it
_STRIBECK = (
    0.01,
    0.07,
)  # of f, and of what a Stribeck curve falls by: the level that it goes down to
_SHAPE = 0.004  # of f: what a shape parameter that is searched for may take or give


@dataclass(frozen=True, slots=True)
class ModulatingEstimate:
    """Result of the fit; each number with its interval.

    Attributes
    ----------
    coulomb, offset : N.m or N
    viscous : N.m.s/rad or N.s/m
    inertia : kg.m2 or kg
    dead_time : s
    fit : friction law that the record asks for, its coefficients, and the model of the axis
    low_speed : friction at the lowest speed that the law resolves, where compensation acts, N.m or
        N
    peak_speed : largest speed of the record, rad/s or m/s
    residual, held_out, rigid_residual : what is left as a share of the torque: of the law, on
        periods that were left out, and of Coulomb friction alone
    condition : of the scaled least-squares matrix; large means that the record cannot tell apart
    halves, widths : relative difference of f between odd and even periods, wide and narrow windows
    lateness : median distance of the reversals from zero velocity, as a share of a sample
    noise : what the resolution alone would leave, as a share of the torque
    periods, seconds : of the record
    windows : that were used
    reversals : that were found
    """

    coulomb: Estimate
    offset: Estimate
    viscous: Estimate
    inertia: Estimate
    dead_time: Estimate
    fit: Fit
    low_speed: float
    peak_speed: float
    residual: float
    held_out: float
    rigid_residual: float
    condition: float
    halves: float
    widths: float
    lateness: float
    noise: float
    periods: float
    seconds: float
    windows: int
    reversals: int

    @property
    def law(self) -> Law:
        """Friction law."""
        return self.fit.law

    @property
    def coefficients(self) -> Array:
        """Coefficients of the terms of the law."""
        return self.fit.coefficients

    def curve(self, speed: Array) -> Array:
        """Friction against speed, mean of both directions, (n,) N.m or N."""
        return curve(self.law, self.coefficients, self.viscous.value, speed)


def estimate(
    record: Record, *, any_motion: bool = False, ladder: bool = True
) -> ModulatingEstimate:
    """Fit the record; raises NotShown when it is too short.

    Two amplitudes are needed in the record to tell Coulomb from viscous friction. A richer friction
    law is looked for where Coulomb friction leaves something unexplained. `any_motion`: the record
    is no oscillation; windows of many widths are used, none in which the axis rests. Without
    `ladder` friction is Coulomb and viscous, whatever that leaves.
    """
    fitter = Fitter(record)
    if any_motion:
        samples = fitter.period / fitter.step
        count = max(int(np.log(0.5 * samples / _FEW_SAMPLES) / np.log(1 / _NARROWER)) + 1, 2)
        shares = tuple(float(x) for x in 0.5 * _NARROWER ** np.arange(count))
        fitter = Fitter(record, shares, rests(record))
    rigid = fitter.fit(Law())
    fit = _climb(fitter, rigid) if ladder else rigid
    shapes = [fit] if fit.law.stribeck is None else fitter.with_exponents(fit)
    fit = min(shapes, key=lambda one: one.held_out)
    # what the whole record shows, however little it leaves of the torque
    for rung in _LINEAR if ladder else ():
        if fit.held_out > _NEARLY_EXPLAINED or rung not in _beside(fit.law):
            continue
        if fitter.shows(fit, rung):
            fit = fitter.with_rung(fit, rung) or fit
    found = _numbers(fitter, fit, rigid)
    # shapes that the record does not tell apart differ in what they say beyond its speeds
    limit = _AS_GOOD * min(_beyond_noise(fitter, one) for one in shapes)
    others = [one for one in shapes if _beyond_noise(fitter, one) <= limit]
    alike = [found, *(_numbers(fitter, one, rigid) for one in others)]
    return replace(
        found,
        coulomb=_spanning(found.coulomb, [one.coulomb for one in alike]),
        viscous=_spanning(found.viscous, [one.viscous for one in alike]),
    )


def _beyond_noise(fitter: Fitter, fit: Fit) -> float:
    """What is left on held-out periods beyond the noise of the resolution, of the torque."""
    return sqrt(max(fit.held_out**2 - fitter.noise(fit) ** 2, 0.0))


def _spanning(value: Estimate, others: list[Estimate]) -> Estimate:
    """With an interval that holds those of all."""
    return Estimate(value.value, min(o.low for o in others), max(o.high for o in others))


def _numbers(fitter: Fitter, fit: Fit, rigid: Fit) -> ModulatingEstimate:
    """The fit as numbers."""
    errors = np.sqrt(np.maximum(np.diag(fit.covariance), 0))
    f, model = float(fit.coefficients[0]), fit.model
    peak = float(np.abs(fitter.motion_of(fit).cells.velocity).max())
    slowest = fit.law.stribeck or 0.02 * peak
    low = float(curve(fit.law, fit.coefficients, model.viscous, np.array([0.2 * slowest]))[0])
    seconds = float(fitter.record.time[-1] - fitter.record.time[0])
    halves, widths = (abs(a - b) for a, b in (fit.halves, fit.widths))
    more = _systematic(fitter, fit, peak, widths)
    return ModulatingEstimate(
        coulomb=Estimate.around(f, float(errors[3]), more.coulomb),
        offset=Estimate.around(model.offset, float(errors[2]), more.offset),
        viscous=Estimate.around(model.viscous, float(errors[1]), more.viscous),
        inertia=Estimate.around(model.inertia, float(errors[0]), more.inertia),
        dead_time=Estimate.around(max(model.dead_time, 0.0), float(errors[-1]), more.dead_time),
        fit=fit,
        low_speed=low,
        peak_speed=peak,
        residual=fit.residual,
        held_out=fit.held_out,
        rigid_residual=rigid.held_out,
        condition=fit.condition,
        halves=halves / abs(f) if f else float("inf"),
        widths=widths / abs(f) if f else float("inf"),
        lateness=fit.lateness,
        noise=fitter.noise(fit),
        periods=seconds / fitter.period,
        seconds=seconds,
        windows=fitter.windows,
        reversals=fitter.count,
    )


@dataclass(frozen=True, slots=True)
class _Systematic:
    """What each number's interval holds beside the scatter, in its unit."""

    coulomb: float
    offset: float
    viscous: float
    inertia: float
    dead_time: float


def _systematic(fitter: Fitter, fit: Fit, peak: float, widths: float) -> _Systematic:
    """`peak` : speed, rad/s or m/s; `widths`: f of wide windows less that of narrow ones."""
    f, model, law = float(fit.coefficients[0]), fit.model, fit.law
    swing = float(np.abs(fitter.record.command - fitter.record.command.mean()).mean())
    left = swing * fit.residual  # torque that no term explains, N.m or N
    # what is more than noise may be a law of its own, which takes a multiple of it
    beyond_noise = swing * min(_beyond_noise(fitter, fit), EXPLAINS)
    late = fit.lateness * fitter.step / fitter.period  # reversals off zero velocity, of a period
    if not fit.held_out < EXPLAINS:  # they make up for a law that is another
        late = fit.lateness
    loaded = _LOADED if law.load else 0.0
    level = 0.0
    if law.stribeck is not None:  # and what the fastest speed still has of it
        over = float(fit.coefficients[law.place("stribeck")]) / f
        tail = float(np.exp(-((peak / law.stribeck) ** law.exponent)))
        level = _STRIBECK[0] + over * (_STRIBECK[1] + tail)
    beyond = 0.0
    if law.soft is not None:  # a level that the speed does not reach is extrapolated
        beyond = min(_REACHED / float(np.cosh(min(peak / law.soft, 50.0))) ** 2, 0.25)
    shape = _SHAPE if law.soft is not None or law.load else 0.0
    share = 5e-4 + 2 * late + shape + level + beyond
    slope = 2 * (beyond + _LATE_VISCOUS * late) + loaded + level
    return _Systematic(
        coulomb=f * share + 0.5 * left + 0.25 * widths + _A_LAW * beyond_noise,
        offset=5e-4 * f + 0.3 * left,
        viscous=2e-3 * abs(model.viscous) + (left + slope * f) / peak,
        inertia=model.inertia * (1.5e-3 + 1.2 * fit.residual + _LATE_INERTIA * late + loaded),
        dead_time=0.02 * model.dead_time + (0.01 + _LATE * fit.lateness) * fitter.step,
    )


def refined_kinematics(record: Record) -> Kinematics:
    """Velocity and its sign changes, by the model where it explains the record.

    A rigid axis gives them to a hundredth of a sample; else the samples alone do.
    """
    try:
        fitter = Fitter(record)
    except ValueError:
        return kinematics(record)
    fit = fitter.fit(Law())
    if not fit.held_out < EXPLAINS:
        return kinematics(record)
    motion = fitter.motion_of(fit)
    return Kinematics(motion.instants, motion.begins, motion.speed)


def _climb(fitter: Fitter, rigid: Fit) -> Fit:
    """The simplest law that no richer one beats clearly on held-out periods."""
    best = rigid
    for enough in _EXPLAINED:
        if best.held_out < max(enough, 1.2 * fitter.noise(best)):
            return best
        richer = [
            found
            for rung in _beside(best.law)
            if (found := fitter.with_rung(best, rung)) is not None
            and (not found.law.drift or found.held_out < _EXPLAINED_BY_DRIFT)
        ]
        if not richer:
            return best
        challenger = min(richer, key=lambda fit: fit.held_out)
        enough_better = _BETTER if best.lateness < SUSPICIOUS else _BETTER_THAN_SUSPICIOUS
        if not challenger.held_out < enough_better * best.held_out:
            return best
        best = challenger
    return best


def _beside(law: Law) -> tuple[Rung, ...]:
    """Rungs that may be added to a law."""
    rungs: list[Rung] = []
    if law.stribeck is None and law.soft is None and not law.drag:
        rungs += ["stribeck", "soft"]
    if not law.load:
        rungs.append("load")
    if not law.drag and law.stribeck is None:  # together they take on any shape
        rungs.append("drag")
    if not law.drift:
        rungs.append("drift")
    if law.position is None:
        rungs.append("position")
    return tuple(rungs)
