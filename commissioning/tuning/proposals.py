"""Every rule, from the distorted point and from the right one, and what its gains are worth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import degrees, pi
from typing import Literal

from commissioning.identification.critical_point import (
    CriticalPoint,
    at_phase,
    autotuned,
    from_model,
)
from commissioning.identification.estimate import Estimate
from commissioning.tuning.controllers import Gains
from commissioning.tuning.margins import LEAST_MARGIN, MOST_SENSITIVITY, Margins, margins
from commissioning.tuning.plant import LoopPlant
from commissioning.tuning.rules import (
    Cascade,
    astrom_hagglund,
    cascade,
    landau_voda_pi,
    landau_voda_pid,
    symmetrical_optimum,
    tyreus_luyben_pi,
    tyreus_luyben_pid,
    ziegler_nichols_pi,
    ziegler_nichols_pid,
)
from commissioning.tuning.step import Friction, StepCourse, step

__all__ = [
    "FEWEST_CYCLES",
    "RULES",
    "AxisKnown",
    "CannotHold",
    "Hold",
    "LoopName",
    "NotProposed",
    "Proposal",
    "Source",
    "proposals",
]

LoopName = Literal["host", "drive"]
Source = Literal["naive", "corrected"]

FEWEST_CYCLES = 10  # of the loop in a period of a point: below, the loop cannot be closed there
_PHASE_OF_ANY_POINT = -190.0  # degrees: the point of a drive's loop for a rule that takes any
_LARGEST_ERROR = 0.1  # of the step: friction stops the axis short of its goal
_LARGEST_OVERSHOOT = 0.5  # of the step
_BEYOND_SEEN = 1.1  # of the frequency to which the axis was seen: how fast a loop may be
_STEP_SHARE = 0.05  # of the travel
_DEFAULT_CROSSOVER = 0.3  # over the loop's delay, for the step of a loop without one

RULES = (
    "ziegler-nichols-pi", "ziegler-nichols-pid", "tyreus-luyben-pi", "tyreus-luyben-pid",
    "astrom-hagglund", "landau-voda-pi", "landau-voda-pid", "symmetrical-optimum", "cascade",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class AxisKnown:
    """What a run knows of its axis.

    Attributes
    ----------
    inertia : kg.m2 or kg
    viscous : N.m.s/rad or N.s/m; None: not identified
    dead_time : of the plant between torque in force and position, s
    friction_share : f/d of the relay test, d half of the relay's swing
    naive, corrected : the relay's own point as an autotuner reads it, and the plant there; None:
        unknown
    measured : the plant where an oscillation was held at −180° or −135°, by that phase
    friction : for the step
    travel : rad or m, on either side
    seen : rad/s, up to which the record shows the axis; nothing is known of a resonance beyond
    """

    inertia: float
    viscous: float | None
    dead_time: float
    friction_share: float
    naive: CriticalPoint | None
    corrected: CriticalPoint | None
    measured: dict[float, CriticalPoint]
    friction: Friction
    travel: float
    seen: float


@dataclass(frozen=True, slots=True)
class NotProposed:
    """Why a set of gains is not proposed: a stable name, and one line for people."""

    code: str
    text: str


@dataclass(frozen=True, slots=True)
class Proposal:
    """One rule from one source.

    Attributes
    ----------
    rule : its name
    loop : closed over the link, or inside the drive
    source : from the point as a relay autotuner reads it, or from the right one
    point : of the loop's plant, that the gains are from; None for rules of the parameters
    gains : None where the rule cannot be used here
    margins, step : on the identified axis; None without gains, or for a velocity loop
    why_not : why it is not proposed; None where it is
    """

    rule: str
    loop: LoopName
    source: Source
    point: CriticalPoint | None
    gains: Gains | None
    margins: Margins | None
    step: StepCourse | None
    why_not: NotProposed | None

    @property
    def proposed(self) -> bool:
        """Whether the set may be taken."""
        return self.why_not is None


class _NotHere(Exception):
    """A rule that this axis or loop has nothing for."""


Hold = Callable[[Gains], Gains]


class CannotHold(Exception):
    """Gains that a controller cannot hold; `why`: a WhyNot."""

    def __init__(self, code: str, text: str) -> None:
        super().__init__(text)
        self.why = NotProposed(code, text)


def _as_they_are(gains: Gains) -> Gains:
    return gains


def proposals(
    known: AxisKnown, loop: LoopName, plant: LoopPlant, hold: Hold = _as_they_are
) -> list[Proposal]:
    """All rules for one loop.

    `hold` gives the gains as the controller can hold them, and raises CannotHold where it cannot.
    """
    points = _Points(known, loop, plant)
    sources: tuple[Source, ...] = ("naive", "corrected")
    return [_one(rule, source, points, hold) for rule in RULES for source in sources]


@dataclass(frozen=True, slots=True)
class _Points:
    """The points of one loop's plant, torque to position, its hold and dead time included."""

    known: AxisKnown
    loop: LoopName
    plant: LoopPlant

    def ultimate(self, source: Source) -> CriticalPoint:
        """The point at −180°, or what is taken for it."""
        return self._autotuned(0.0) if source == "naive" else self._at(-180.0)

    def any(self, source: Source) -> CriticalPoint:
        """The relay's own point."""
        if self.loop == "drive":
            return self._autotuned(0.0) if source == "naive" else self._at(_PHASE_OF_ANY_POINT)
        known = self.known
        point = known.naive if source == "naive" else known.corrected
        if point is None:
            raise _NotHere("the relay's point is not known")
        if source == "naive":
            return point
        # the point is the plant's, in which the hold of the loop is left out
        turned = degrees(2 * pi / point.period * (self.plant.delay - known.dead_time))
        return replace(point, phase_deg=point.phase_deg - turned)

    def at_135(self, source: Source) -> CriticalPoint:
        """The point at −135°, or what a relay with 45° of hysteresis is taken to show."""
        return self._autotuned(45.0) if source == "naive" else self._at(-135.0)

    def _at(self, phase: float) -> CriticalPoint:
        j, b, tau = self._model()
        gain, turned = self._seen_at(max(phase, -180.0))
        found = at_phase(j, b, tau, phase - turned)
        if found is None:
            raise _NotHere(f"the loop's plant has no point at {phase:g}°")
        return self._within(replace(found, gain=gain * found.gain, phase_deg=phase))

    def _seen_at(self, phase: float) -> tuple[float, float]:
        """By what the measured plant differs from the model near a phase: a factor, and degrees."""
        known, seen = self.known, self.known.measured.get(phase)
        if seen is None or known.viscous is None:
            return 1.0, 0.0
        j, b, tau = (Estimate(v, v, v) for v in (known.inertia, known.viscous, known.dead_time))
        model = from_model(j, b, tau, seen.period)
        return seen.gain / model.gain, (seen.phase_deg - model.phase_deg + 180) % 360 - 180

    def _autotuned(self, hysteresis_deg: float) -> CriticalPoint:
        """What a relay autotuner with this hysteresis concludes.

        In the test that was run, or by −1/N.
        """
        if self.loop == "host" and not hysteresis_deg:
            if self.known.naive is None:
                raise _NotHere("no relay test was read")
            return self.known.naive
        j, b, tau = self._model()
        found = autotuned(j.value, b.value, tau.value, self.known.friction_share, hysteresis_deg)
        if found is None:
            raise _NotHere("a relay does not oscillate like that on this axis")
        return self._within(found)

    def _within(self, point: CriticalPoint) -> CriticalPoint:
        cycle = self.plant.cycle
        if point.period < FEWEST_CYCLES * cycle:
            raise _NotHere(
                f"its point at {point.period * 1000:.3g} ms is beyond a cycle of {cycle * 1000:g} "
                "ms"
            )
        return point

    def _model(self) -> tuple[Estimate, Estimate, Estimate]:
        if self.known.viscous is None:
            raise _NotHere("viscous friction is not identified, so the point is not known")
        values = (self.known.inertia, self.known.viscous, self.plant.delay)
        j, b, tau = (Estimate(v, v, v) for v in values)
        return j, b, tau


_Make = Callable[[_Points, Source], tuple[CriticalPoint | None, Gains]]


def _from_ultimate(rule: Callable[[float, float], Gains]) -> _Make:
    def make(points: _Points, source: Source) -> tuple[CriticalPoint, Gains]:
        point = points.ultimate(source)
        return point, rule(1 / point.gain, point.period)

    return make


def _from_135(rule: Callable[[float, float], Gains]) -> _Make:
    def make(points: _Points, source: Source) -> tuple[CriticalPoint, Gains]:
        point = points.at_135(source)
        return point, rule(point.gain, 2 * pi / point.period)

    return make


def _from_any(points: _Points, source: Source) -> tuple[CriticalPoint, Gains]:
    point = points.any(source)
    try:
        return point, astrom_hagglund(point.gain, point.phase_deg, 2 * pi / point.period)
    except ValueError as error:
        raise _NotHere(str(error)) from None


def _from_parameters(rule: Callable[[float, float, float, float], Gains]) -> _Make:
    """Rules of J, B and the delay; a naive autotuner has its J from |G| = 1/(J·ω²)."""

    def make(points: _Points, source: Source) -> tuple[CriticalPoint | None, Gains]:
        plant, known = points.plant, points.known
        # a velocity that is the difference of two samples is half a cycle old
        delay = plant.delay + plant.cycle / 2
        if source == "corrected":
            return None, rule(known.inertia, known.viscous or 0.0, delay, known.seen)
        point = known.naive
        if point is None:
            raise _NotHere("no relay test was read")
        inertia = 1 / (point.gain * (2 * pi / point.period) ** 2)
        return point, rule(inertia, 0.0, delay, known.seen)

    return make


_MAKE: dict[str, _Make] = {
    "ziegler-nichols-pi": _from_ultimate(ziegler_nichols_pi),
    "ziegler-nichols-pid": _from_ultimate(ziegler_nichols_pid),
    "tyreus-luyben-pi": _from_ultimate(tyreus_luyben_pi),
    "tyreus-luyben-pid": _from_ultimate(tyreus_luyben_pid),
    "astrom-hagglund": _from_any,
    "landau-voda-pi": _from_135(landau_voda_pi),
    "landau-voda-pid": _from_135(landau_voda_pid),
    "symmetrical-optimum": _from_parameters(lambda j, b, t, seen: symmetrical_optimum(j, t)),
    "cascade": _from_parameters(cascade),
}


def _one(rule: str, source: Source, points: _Points, hold: Hold) -> Proposal:
    try:
        point, gains = _MAKE[rule](points, source)
    except _NotHere as error:
        why = NotProposed("gains.no-point", str(error))
        return Proposal(rule, points.loop, source, None, None, None, None, why)
    cannot = None
    try:
        gains = hold(gains)
    except CannotHold as error:
        cannot = error.why
    worth = margins(points.plant, gains)
    moved = None
    if not (isinstance(gains, Cascade) and not gains.position_gain):
        crossover = worth.crossover or _DEFAULT_CROSSOVER / points.plant.delay
        size = _STEP_SHARE * points.known.travel
        moved = step(points.plant, gains, points.known.friction, size, crossover)
    why_not = _why_not(worth, moved, points.known) or cannot
    if why_not is None and source == "naive":
        why_not = NotProposed("gains.distorted", "from the point as a relay autotuner reads it")
    return Proposal(rule, points.loop, source, point, gains, worth, moved, why_not)


def _why_not(worth: Margins, moved: StepCourse | None, known: AxisKnown) -> NotProposed | None:
    """Why a set is not proposed."""
    goal = known.travel * _STEP_SHARE
    checks = (
        (not worth.stable, NotProposed("gains.unstable", "the loop is unstable")),
        (
            worth.phase is None,
            NotProposed("gains.no-crossover", "the loop's gain never passes 1"),
        ),
        (
            worth.phase is not None and worth.phase < LEAST_MARGIN,
            NotProposed("gains.margin", f"its phase margin is below {LEAST_MARGIN:g}°"),
        ),
        (
            worth.sensitivity > MOST_SENSITIVITY,
            NotProposed("gains.sensitivity", f"its sensitivity Ms is above {MOST_SENSITIVITY:g}"),
        ),
        (
            worth.crossover is not None and worth.crossover > _BEYOND_SEEN * known.seen,
            NotProposed(
                "gains.too-fast",
                f"the axis was seen up to {known.seen:.3g} rad/s, and may have a resonance beyond",
            ),
        ),
        (
            moved is not None and abs(moved.error) + moved.hunting > _LARGEST_ERROR * goal,
            NotProposed(
                "gains.off-goal", "friction stops the axis short of its goal, or it hunts about it"
            ),
        ),
        (
            moved is not None and moved.overshoot > _LARGEST_OVERSHOOT,
            NotProposed(
                "gains.overshoots",
                f"it overshoots by more than {100 * _LARGEST_OVERSHOOT:.0f} % with this friction "
                "and torque limit",
            ),
        ),
        (
            moved is not None and moved.settling is None,
            NotProposed(
                "gains.unsettled",
                "it does not stay within 2 % of the step while it was followed",
            ),
        ),
    )
    return next((why for applies, why in checks if applies), None)
