"""Friction by output error: the positions themselves are fitted, with a free state a segment.

The motion of the model (`trajectory`) is compared with every sample; what differs is the noise of
the position where the model is right, so the numbers come as near to the Cramér–Rao bound as a
record allows, and what differs by more says that the model lacks something (method.md 9.1–9.4,
9.7). Levenberg–Marquardt with the states of the segments eliminated; one more term of the friction
law where it explains clearly more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan, hypot, pi, sqrt
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from commissioning.identification.bending import stribeck_columns
from commissioning.identification.errors import NotShown
from commissioning.identification.estimate import Estimate
from commissioning.identification.motion import Model
from commissioning.identification.position_fit import BASE, NUMBER, WHITE, PositionFit
from commissioning.identification.record import Record
from commissioning.identification.segments import segments_of

__all__ = ["OutputErrorEstimate", "Progress", "Term", "output_error"]

Array = NDArray[np.float64]
Term = Literal["drag", "load", "drift", "spring", "eccentricity"]

# each further term, and the parameters that it has
_TERMS: dict[Term, tuple[int, ...]] = {
    "drag": (NUMBER["drag"],),
    "load": (NUMBER["load"],),
    "drift": (NUMBER["drift"],),
    "spring": (NUMBER["spring"],),
    "eccentricity": (NUMBER["eccentricity_cos"], NUMBER["eccentricity_sin"]),
}
_J, _B, _F, _OFFSET, _DELAY, _LAG = BASE
_SEARCH, _LAST = 1, 4  # periods of a segment while laws are compared, and of the last fit

_FEW_STEPS = 4  # of a law that is tried
_AS_GOOD = 1.15  # times the standard deviation: longer segments that explain as much
_MOST_TERMS, _TRIED = 3, 2
# terms that a curve which falls with the speed can look like
_IMITATED = {NUMBER["drag"], NUMBER["load"]}
_HOPELESS = 2.5, 0.01  # colour and misfit that the best term leaves: another one is not all either
_ENOUGH = 1.15, 1.3  # colour, and times the noise: below, no further term is looked for
_FIRST_PROGRESS = 2  # segments of one period; one alone hardly tells Coulomb from viscous friction
_WINDS, _A_PART = 0.5, 0.6  # of f that a spring takes at a half-swing; of the friction known before
_NEARLY = 0.05  # misfit of a law beside which a curve is tried
_LOW_SPEED = 4e-3  # of the peak speed
_WIDER = 1.35  # what held 97 % beyond the draws that the factors are of
_STAT_WHITE, _STAT_COLOURED, _SYSTEMATIC, _OF_MISFIT = 1.25, 3.0, 2e-4, 0.5


@dataclass(frozen=True, slots=True)
class Progress:
    """Coulomb friction after some of the periods, N.m or N."""

    periods: float
    coulomb: Estimate


@dataclass(frozen=True, slots=True)
class OutputErrorEstimate:
    """Result of the fit; each number with its interval.

    Attributes
    ----------
    coulomb : mean of the friction level over the samples used, N.m or N
    offset : N.m or N
    viscous : N.m.s/rad or N.s/m
    inertia : kg.m2 or kg
    dead_time : s, of the torque at the record's own frequency, its lag included
    lag : s, of the torque behind its command, first order
    terms : what the law has beside Coulomb and viscous friction
    values : size of each: drag N.m.s2/rad2, load as a share, drift 1/s, spring N.m/rad,
        eccentricity rad
    half_swing, peak_speed, period : typical, rad or m, rad/s or m/s, s
    rms, noise : of what is left of the position, and of the position itself, rad or m
    colour : κ; 1: what is left is white
    misfit : what is left beyond the noise, as a torque, of the friction
    is_explained : whether what is left is noise, and the law one that friction can have
    bent_level : that friction falls to with the speed, where such a curve would explain as much,
        N.m or N; None: it would not
    periods, seconds, samples : that were used
    middle : of the samples that were used, on the record's clock, s: where a drift is none
    progress : what fewer periods would have given
    """

    coulomb: Estimate
    offset: Estimate
    viscous: Estimate
    inertia: Estimate
    dead_time: Estimate
    lag: Estimate
    terms: tuple[Term, ...]
    values: tuple[Estimate, ...]
    half_swing: float
    peak_speed: float
    period: float
    rms: float
    noise: float
    colour: float
    misfit: float
    is_explained: bool
    bent_level: float | None
    periods: float
    seconds: float
    samples: int
    middle: float
    progress: tuple[Progress, ...] = ()

    @property
    def bends(self) -> bool:
        """Whether friction that falls with the speed would explain as much."""
        return self.bent_level is not None

    @property
    def low_speed(self) -> float:
        """Friction at the lowest speed that the law resolves, N.m or N."""
        return float(self.curve(np.array([_LOW_SPEED * self.peak_speed]))[0])

    def only_winds_up(self, friction: float) -> bool:
        """Whether what moved is in front of a spring whose other end has not moved.

        `friction` : of the whole axis, as first motions showed it, N.m or N
        """
        winds = self.size("spring") * self.half_swing
        return winds > _WINDS * self.coulomb.value and self.coulomb.value < _A_PART * friction

    def size(self, term: Term) -> float:
        """Of a term; 0 where the law has it not."""
        return self.values[self.terms.index(term)].value if term in self.terms else 0.0

    def curve(self, speed: Array) -> Array:
        """Friction against speed, mean of both directions, (n,) N.m or N."""
        rising = self.viscous.value * speed + self.size("drag") * speed**2
        result: Array = self.coulomb.value + rising
        return result


def output_error(
    record: Record,
    start: Model,
    coulomb: float,
    *,
    noise: float = 0.0,
    rotary: bool = True,
    spans: Sequence[tuple[float, float]] = (),
) -> OutputErrorEstimate:
    """Fit the positions of a record; raises NotShown where it does not oscillate.

    Parameters
    ----------
    start, coulomb : where to begin; good to a third or so; N.m or N
    noise : rms of the position at rest beside its resolution, rad or m
    rotary : whether the position is an angle, which an encoder may show eccentrically
    spans : begin and end of what may be used, s; (): all
    """
    candidates = tuple(term for term in _TERMS if rotary or term != "eccentricity")
    with np.errstate(all="ignore"):  # what diverges costs infinitely much
        try:
            return _fitted(record, start, coulomb, noise, candidates, spans)
        except np.linalg.LinAlgError:
            raise NotShown("no rigid axis moves like this") from None


def _fitted(
    record: Record,
    start: Model,
    coulomb: float,
    noise: float,
    candidates: tuple[Term, ...],
    spans: Sequence[tuple[float, float]],
) -> OutputErrorEstimate:
    fit = PositionFit.begun(segments_of(record, _SEARCH, spans), start, coulomb, noise).solved()
    if not np.isfinite(fit.cost):
        raise NotShown("no rigid axis moves like this")
    fit, level = _climbed(fit, candidates)
    if level is not None or (fit.colour > _HOPELESS[0] and fit.misfit > _HOPELESS[1]):
        return _numbers(fit, level, _progress(fit), wanders=True)
    last = fit.on(segments_of(record, _LAST, spans)).solved()
    whiter = np.isfinite(last.cost) and last.colour < WHITE <= fit.colour
    wanders = not whiter and not last.variance <= _AS_GOOD**2 * fit.variance
    return _numbers(fit if wanders else last, level, _progress(fit), wanders=wanders)


def _climbed(fit: PositionFit, candidates: tuple[Term, ...]) -> tuple[PositionFit, float | None]:
    """With one more term where it explains clearly more, until what is left is noise.

    Also the level of a Stribeck curve that would have explained as much: the law is another then.
    """
    for _ in range(_MOST_TERMS):
        if fit.colour < _ENOUGH[0] and fit.variance < _ENOUGH[1] ** 2 * fit.floor:
            break
        gains = sorted(_gains(fit, candidates), reverse=True)
        bent, level = _bends(fit)
        if gains and bent > gains[0][0] and fit.is_worth(bent, 2):
            return fit, level
        tried = [fit.with_terms(_TERMS[term]).solved(_FEW_STEPS) for _, term in gains[:_TRIED]]
        richer = min(tried, key=lambda one: one.variance, default=fit)
        more = len(richer.which) - len(fit.which)
        if not fit.is_worth(fit.cost - richer.cost, more):
            break
        richer = richer.solved()
        if _IMITATED & set(richer.which[-more:]) and richer.is_no_worse(fit.cost - bent):
            return richer, level
        fit = richer
        if fit.colour > _HOPELESS[0] and fit.misfit > _HOPELESS[1]:
            break
    bent, level = _bends(fit)
    return fit, level if fit.is_worth(bent, 2) else None


def _gains(fit: PositionFit, candidates: tuple[Term, ...]) -> list[tuple[float, Term]]:
    """By how much each further term should lower the cost: one simulation, no fit."""
    new = [term for term in candidates if not set(_TERMS[term]) & set(fit.which)]
    wide = fit.with_terms(tuple(n for term in new for n in _TERMS[term])).answered()
    assert wide.answer is not None
    columns = wide.projected(wide.answer.by_parameter[..., len(fit.which) :])
    found: list[tuple[float, Term]] = []
    for term in new:
        own, columns = np.split(columns, [len(_TERMS[term])], axis=2)
        found.append((fit.gain(own), term))
    return found


def _bends(fit: PositionFit) -> tuple[float, float]:
    """By how much a Stribeck curve should lower the cost, and the level that it goes down to."""
    columns = stribeck_columns(fit)
    gains = [fit.gain(columns[..., n : n + 1]) for n in range(columns.shape[2])]
    best = int(np.argmax(gains))
    return gains[best], fit.level_with(columns[..., best])


def _progress(fit: PositionFit) -> tuple[Progress, ...]:
    """The friction by the first segments alone: one Gauss–Newton step from that of all of them."""
    assert fit.answer is not None
    columns = fit.projected(fit.answer.by_parameter)
    normal = np.cumsum(np.einsum("snp,snq->spq", columns, columns), axis=0)
    gradient = np.cumsum(np.einsum("snp,sn->sp", columns, fit.answer.left), axis=0)
    at, scale, found = fit.which.index(_F), fit.scale[_F], []
    there = fit.segments.is_there
    last = np.take_along_axis(fit.segments.time, there.sum(axis=1)[:, None] - 1, axis=1)[:, 0]
    periods = np.cumsum(last - fit.segments.time[:, 0]) / fit.segments.period
    times = _STAT_WHITE if fit.is_white else _STAT_COLOURED
    for count in range(_FIRST_PROGRESS, len(columns) + 1):
        inverse = np.linalg.pinv(normal[count - 1], rcond=1e-15, hermitian=True)
        value = float(fit.parameters[_F] + (inverse @ gradient[count - 1])[at] * scale)
        error = sqrt(fit.colour * fit.variance * max(inverse[at, at], 0.0)) * scale
        half = float(_WIDER * (2 * times * error + _SYSTEMATIC * abs(value)))
        found.append(
            Progress(float(periods[count - 1]), Estimate(value, value - half, value + half))
        )
    return tuple(found)


class _Told:
    """Numbers of a fit with their intervals."""

    def __init__(self, fit: PositionFit, wanders: bool) -> None:
        self._fit, self._covariance = fit, fit.covariance()
        self._times = _STAT_WHITE if fit.is_white and not wanders else _STAT_COLOURED
        self._more = _SYSTEMATIC + (0.0 if fit.is_white else _OF_MISFIT * fit.misfit)
        f = abs(float(fit.parameters[_F]))
        # what the systematic share is a share of
        self._whole = dict.fromkeys((_F, _OFFSET), f) | {
            _J: float(fit.parameters[_J]), _B: f / fit.segments.speed, _DELAY: fit.segments.step,
        }  # fmt: skip

    def _error(self, n: int) -> float:
        at = self._fit.which.index(n)
        return float(sqrt(self._covariance[at, at]) * self._fit.scale[n])

    def number(self, n: int) -> Estimate:
        """A parameter of every law."""
        return self._around(n, float(self._fit.parameters[n]), self._error(n))

    def _around(self, n: int, value: float, error: float) -> Estimate:
        half = float(_WIDER * (2 * self._times * error + self._more * self._whole[n]))
        return Estimate(value, value - half, value + half)

    def size(self, term: Term) -> Estimate:
        """What a further term comes to."""
        numbers = _TERMS[term]
        values = [float(self._fit.parameters[n]) for n in numbers]
        value = values[0] if len(values) == 1 else hypot(*values)
        half = _WIDER * 2 * self._times * max(self._error(n) for n in numbers)
        return Estimate(value, value - half, value + half)

    def lag(self) -> Estimate:
        """Of the torque: known by its square."""
        square = float(self._fit.parameters[_LAG])
        half = _WIDER * 2 * self._times * self._error(_LAG)
        return Estimate(sqrt(square), sqrt(max(square - half, 0.0)), sqrt(square + half))

    def dead_time(self) -> Estimate:
        """By which the torque comes late at the record's own frequency."""
        fit, lag, w = self._fit, float(self._fit.axis[_LAG]), 2 * pi / self._fit.segments.period
        places = [fit.which.index(_DELAY), fit.which.index(_LAG)]
        turn = np.array([fit.scale[_DELAY], 0.0])
        if lag > 0:
            turn[1] = (1 / (1 + (w * lag) ** 2) - 1) / (2 * lag) * fit.scale[_LAG]
        error = float(np.sqrt(turn @ self._covariance[np.ix_(places, places)] @ turn))
        return self._around(_DELAY, float(fit.parameters[_DELAY]) - lag + atan(w * lag) / w, error)


def _numbers(
    fit: PositionFit, level: float | None, progress: tuple[Progress, ...], *, wanders: bool
) -> OutputErrorEstimate:
    """The fit as numbers; `wanders`: longer segments leave more, so the motion itself is noisy."""
    told, segments = _Told(fit, wanders), fit.segments
    if not (level is not None and level > 0 and fit.misfit < _NEARLY):
        level = None  # next to a motion that is far off, a curve says nothing
    coulomb, viscous, inertia = (told.number(n) for n in (_F, _B, _J))
    terms = tuple(term for term, numbers in _TERMS.items() if set(numbers) <= set(fit.which))
    values = {term: told.size(term) for term in terms}
    # friction that falls with speed, or torque, is another law
    positive = [coulomb, viscous, inertia]
    positive += [values[term] for term in terms if term in ("drag", "load")]
    spans = [t[there] for t, there in zip(segments.time, segments.is_there, strict=True)]
    return OutputErrorEstimate(
        coulomb=coulomb,
        offset=told.number(_OFFSET),
        viscous=viscous,
        inertia=inertia,
        dead_time=told.dead_time(),
        lag=told.lag(),
        terms=terms,
        values=tuple(values.values()),
        half_swing=segments.swing,
        peak_speed=segments.speed,
        period=segments.period,
        rms=sqrt(fit.variance),
        noise=sqrt(fit.floor),
        colour=fit.colour,
        misfit=fit.misfit,
        is_explained=fit.is_white and level is None and all(one.high > 0 for one in positive),
        bent_level=level,
        periods=float(sum(t[-1] - t[0] for t in spans)) / segments.period,
        seconds=segments.span,
        samples=segments.samples,
        middle=segments.origin + segments.middle,
        progress=progress,
    )
