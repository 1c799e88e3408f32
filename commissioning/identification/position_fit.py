"""One law of an axis fitted to positions: Levenberg–Marquardt, the segments' states eliminated.

What is left tells how right the law is: white and no larger than the noise of the position where it
is (method.md 9.2, 9.3).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, log, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from commissioning.identification.motion import Model
from commissioning.identification.segments import SEEN, Answers, Segments

__all__ = ["BASE", "NOISY", "NUMBER", "WHITE", "PositionFit"]

Array = NDArray[np.float64]

NUMBER = {name: n for n, name in enumerate(SEEN)}
BASE = tuple(NUMBER[n] for n in ("inertia", "viscous", "coulomb", "offset", "delay", "lag"))
_J, _B, _F, _OFFSET, _DELAY, _LAG = BASE
_STEP, _SQUARE_STEP = 1e-4, 1e-3  # of their scales, by which parameters are changed
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-6, 1e-13, 1e3
_EASIER = 30.0  # by which damping is divided after a step that was good
_AHEAD = 1.5  # samples
_LONGEST_LAG = 2.0  # of the whole delay: a torque that only lags is no edge of what may be
_ABSURD = 1e9  # swings: what diverges
_DONE = 0.02  # of what one standard error changes the cost by: a step that brings less is the last
WHITE, NOISY = 1.35, 2.5
_PLAIN = 2.0, 1.1  # colour, and times the noise
_MANY_SAMPLES, _SOME_SAMPLES, _MISFIT = 40, 20, 0.03
_DEARER = 10.0  # by which (n/κ)·ln(c₀/c₁) must exceed k·ln n for a term of k numbers
_BLOCKS = 16  # a period, by which colour is judged
_MOST_STEPS = 12


@dataclass(frozen=True, slots=True)
class PositionFit:
    """One law on one set of segments.

    Attributes
    ----------
    which : numbers of the free parameters
    parameters : (12,); the lag's place has its square, s2: to that positions answer evenly
    states : (s, 2)
    scale : (12,) of parameters; the lag's of its square, s2
    answer : to them; None: not simulated yet
    """

    segments: Segments
    which: tuple[int, ...]
    parameters: Array
    states: Array
    scale: Array
    noise: float
    answer: Answers | None = None

    @classmethod
    def begun(cls, segments: Segments, model: Model, f: float, noise: float) -> PositionFit:
        """From what is known."""
        segments = segments.begun_between(model.dead_time)
        parameters = np.zeros(len(SEEN))
        delay = max(model.dead_time, 0.1 * segments.step)
        lag = min(0.5 * delay, 0.5 * segments.step)
        parameters[list(BASE)] = model.inertia, model.viscous, f, model.offset, delay, lag**2
        return cls(
            segments, BASE, parameters, segments.first_states(), _scales(segments, parameters),
            noise,
        )  # fmt: skip

    def on(self, segments: Segments) -> PositionFit:
        """The same law on other segments."""
        segments = segments.begun_between(float(self.parameters[_DELAY]))
        same = np.abs(segments.begin[:, None] - self.segments.begin) < 1e-3 * segments.step
        states = np.where(
            np.any(same, axis=1)[:, None], self.states[same.argmax(axis=1)], segments.first_states()
        )
        return replace(self, segments=segments, states=states, answer=None)

    def with_terms(self, numbers: tuple[int, ...]) -> PositionFit:
        """With further parameters, of size 0."""
        return replace(self, which=(*self.which, *numbers), answer=None)

    # -- Levenberg–Marquardt, the states eliminated -------------------------------------------

    def solved(self, most: int = _MOST_STEPS) -> PositionFit:
        """At its best."""
        now, damping = self.answered(), _FIRST_DAMPING
        for _ in range(most if np.isfinite(now.cost) else 0):
            better, expected = now._step(damping)
            if better.cost < now.cost:
                now, damping = better, max(damping / _EASIER, _LEAST_DAMPING)
            else:
                damping *= 10
            if expected < _DONE * now.variance or damping > _MOST_DAMPING:
                break
        return now

    def answered(self) -> PositionFit:
        """With what the model says at its parameters, and how that answers to them."""
        which, square = list(self.which), _SQUARE_STEP * self.scale[_LAG]
        steps = _STEP * self.scale
        # positions answer evenly to the square of a lag: a lag of 0 would show nothing of itself
        steps[_LAG] = sqrt(self.parameters[_LAG] + square) - self.axis[_LAG]
        answer = self.segments.answer(self.axis, self.states, which, steps)
        shares = np.where(np.array(which) == _LAG, _SQUARE_STEP, _STEP)
        return replace(self, answer=replace(answer, by_parameter=answer.by_parameter / shares))

    @property
    def axis(self) -> Array:
        """Parameters in the order of SEEN, the lag as such."""
        found = self.parameters.copy()
        found[_LAG] = sqrt(max(found[_LAG], 0.0))
        return found

    def _step(self, damping: float) -> tuple[PositionFit, float]:
        """One step, and by how much one without damping should lower the cost."""
        assert self.answer is not None
        left, by, states = self.answer.left, self.answer.by_parameter, self.answer.by_state
        held = self.parameters[_LAG] <= 0
        inner = np.einsum("sni,snj->sij", states, states)
        both = np.einsum("sni,snp->sip", states, by)
        rest = np.einsum("sni,sn->si", states, left)
        normal = np.einsum("snp,snq->pq", by, by)
        gradient = np.einsum("snp,sn->p", by, left)
        free = np.ones(len(gradient), bool)
        lag = self.which.index(_LAG)

        def reduced(damped: float) -> tuple[Array, Array, Array]:
            """Normal equations of the parameters alone, and the inverse of the states' own."""
            inverse = np.linalg.inv(inner + damped * inner * np.eye(2) + 1e-300 * np.eye(2))
            h = normal + damped * np.diag(np.diag(normal))
            h = h - np.einsum("sip,sij,sjq->pq", both, inverse, both)
            g = gradient - np.einsum("sip,sij,sj->p", both, inverse, rest)
            return h, g, inverse

        h, g, _ = reduced(0.0)
        if held and g[lag] < 0:
            free[lag] = False
        within = np.ix_(free, free)
        expected = float(g[free] @ _solution(h[within], g[free]))
        h, g, inverse = reduced(damping)
        moved = np.zeros(len(g))
        moved[free] = _solution(h[within], g[free])
        least = -self.parameters[_LAG] / self.scale[_LAG]
        if moved[lag] < least:  # to where it is none, and the others as is best for that
            free[lag] = False
            moved[lag] = least
            rest_of = g[free] - h[free][:, [lag]] @ moved[[lag]]
            moved[free] = _solution(h[np.ix_(free, free)], rest_of)
        by_states = np.einsum("sij,sj->si", inverse, rest - np.einsum("sip,p->si", both, moved))
        parameters = self.parameters.copy()
        parameters[list(self.which)] += moved * self.scale[list(self.which)]
        parameters = _allowed(parameters, self.parameters, self.segments.step)
        scale = self.segments.state_scale()
        follows = replace(self, parameters=parameters, states=self.states + by_states * scale)
        return follows.answered(), expected

    @property
    def cost(self) -> float:
        """Sum of squares, rad2 or m2; infinite where the motion or what it answers is no number."""
        assert self.answer is not None
        most = _ABSURD * self.segments.swing
        answers = self.answer.left, self.answer.by_parameter, self.answer.by_state
        return self.answer.cost if all((np.abs(a) < most).all() for a in answers) else inf

    # -- what is left -----------------------------------------------------------------------------

    @property
    def variance(self) -> float:
        """Of what is left, rad2 or m2."""
        assert self.answer is not None
        free = self.segments.samples - len(self.which) - 2 * len(self.segments.time)
        return self.cost / max(free, 1)

    @property
    def floor(self) -> float:
        """Variance that the position itself has, rad2 or m2."""
        return self.segments.resolution**2 / 12 + self.noise**2

    @property
    def colour(self) -> float:
        """κ: by how much the mean of a block scatters more than that of white noise would."""
        assert self.answer is not None
        is_there, left = self.segments.is_there, self.answer.left
        block = self.segments.period / (_BLOCKS * self.segments.step)
        variance = max(self.variance, 1e-300)
        if block <= 2:
            pairs = is_there[:, 1:] & is_there[:, :-1]
            together = float((left[:, 1:] * left[:, :-1])[pairs].mean())
            return max(1.0, 1 + 2 * together / variance)
        b = round(block)
        count = left.shape[1] // b
        cut = left[:, : count * b].reshape(len(left), count, b)
        whole = is_there[:, : count * b].reshape(len(left), count, b).all(axis=2)
        return max(1.0, b * float((cut.mean(axis=2)[whole] ** 2).mean()) / variance)

    @property
    def misfit(self) -> float:
        """What is left beyond the noise, as a torque, of the friction."""
        beyond = sqrt(max(self.variance - self.floor, 0.0))
        f, inertia = abs(self.parameters[_F]), self.parameters[_J]
        return float(beyond * (2 * pi / self.segments.period) ** 2 * inertia / max(f, 1e-300))

    @property
    def is_white(self) -> bool:
        """Whether what is left is noise."""
        if not np.isfinite(self.cost):
            return False
        if self.variance < _PLAIN[1] ** 2 * self.floor and self.colour < _PLAIN[0]:
            return True  # what is left is no more than the position's own noise
        if not self.colour < WHITE:
            return False
        samples = self.segments.period / self.segments.step
        return (
            self.variance < NOISY**2 * self.floor
            or samples >= _MANY_SAMPLES
            or (samples >= _SOME_SAMPLES and self.misfit < _MISFIT and self.which == BASE)
        )

    def projected(self, columns: Array) -> Array:
        """What first states cannot take of columns (s, n, k)."""
        assert self.answer is not None
        q, _ = np.linalg.qr(self.answer.by_state)
        return columns - q @ (q.transpose(0, 2, 1) @ columns)

    def gain(self, columns: Array) -> float:
        """By how much further projected columns (s, n, k) would lower the cost, rad2 or m2."""
        assert self.answer is not None
        known = self.projected(self.answer.by_parameter)
        q, _ = np.linalg.qr(known.reshape(-1, known.shape[2]))
        left = self.projected(self.answer.left[..., None]).reshape(-1)
        left = left - q @ (q.T @ left)
        new = columns.reshape(-1, columns.shape[2])
        own, _ = np.linalg.qr(new - q @ (q.T @ new))
        return float(((own.T @ left) ** 2).sum())

    def level_with(self, column: Array) -> float:
        """Coulomb friction, N.m or N, if a further projected column (s, n) were in the law, too."""
        assert self.answer is not None
        known = self.projected(self.answer.by_parameter)
        both = np.concatenate((known, column[..., None]), axis=2)
        flat = both.reshape(-1, both.shape[2])
        left = self.projected(self.answer.left[..., None]).reshape(-1)
        moved = _solution(flat.T @ flat, flat.T @ left)
        at = self.which.index(_F)
        return float(self.parameters[_F] + moved[at] * self.scale[_F])

    def is_worth(self, gain: float, numbers: int) -> bool:
        """Whether so much less cost is worth so many numbers more (Schwarz 1978, and a margin)."""
        n, cost = self.segments.samples, self.cost
        if not 0 < gain < cost:
            return gain >= cost > 0
        return n / self.colour * log(cost / (cost - gain)) - numbers * log(n) > _DEARER

    def is_no_worse(self, cost: float) -> bool:
        """Whether another law of that cost, rad2 or m2, explains about as much as this one."""
        n = self.segments.samples
        return n / self.colour * log(max(cost, 1e-300) / max(self.cost, 1e-300)) < _DEARER

    def covariance(self) -> Array:
        """Of the scaled free parameters, (p, p), scatter of half periods and colour included."""
        assert self.answer is not None
        columns = self.projected(self.answer.by_parameter)
        h = np.einsum("snp,snq->pq", columns, columns)
        inverse = np.linalg.pinv(h, rcond=1e-15, hermitian=True)
        plain = self.colour * self.variance * inverse
        halves = np.floor(self.segments.time / (0.5 * self.segments.period)).astype(int)
        product = columns * self.answer.left[..., None]
        scores = np.zeros((len(product) * (halves.max() + 1), product.shape[2]))
        rows = halves + (halves.max() + 1) * np.arange(len(product))[:, None]
        np.add.at(scores, rows.ravel(), product.reshape(-1, product.shape[2]))
        robust = inverse @ (scores.T @ scores) @ inverse
        larger = np.maximum(np.diag(plain), np.diag(robust))
        spread = np.sqrt(larger / np.maximum(np.diag(plain), 1e-300))
        result: Array = plain * np.outer(spread, spread)
        return result


def _solution(matrix: Array, right: Array) -> Array:
    """Of normal equations; none where they are no numbers: then a step is no step."""
    if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
        return np.zeros(len(right))
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=1e-13)[0], np.float64)


def _scales(segments: Segments, parameters: Array) -> Array:
    f, fast, swing = abs(parameters[_F]), segments.speed, segments.swing
    step, span = segments.step, segments.span
    return np.array(
        [
            parameters[_J],
            f / fast,
            f,
            f,
            step,
            step**2,
            f / fast**2,
            0.1,
            0.1 / span,
            f / swing,
            1e-3,
            1e-3,
        ]
    )


def _allowed(parameters: Array, before: Array, step: float) -> Array:
    """No further at once than the model has a meaning."""
    found = parameters.copy()
    found[_J] = np.clip(found[_J], 0.3 * before[_J], 3 * before[_J])
    # a drive that is read some time after it was commanded seems to have moved before
    found[_DELAY] = max(found[_DELAY], -_AHEAD * step)
    longest = _LONGEST_LAG * max(found[_DELAY], step)
    found[_LAG] = np.clip(found[_LAG], 0.0, longest**2)
    load = NUMBER["load"]
    found[load] = np.clip(found[load], -0.5, 0.8)
    return found
