"""Repeated measurements of one number: mean, spread and drift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from commissioning.identification.estimate import Estimate

__all__ = ["Repeats", "mean_of"]

_FEWEST = 3  # through which a line says more than that two numbers differ
_SURE = 0.975


@dataclass(frozen=True, slots=True)
class Repeats:
    """What repeats of one measurement say together; in the number's unit.

    Attributes
    ----------
    values, times : of each, and the middle of its record, s
    mean : with an interval that holds those of all, and the scatter
    spread : standard deviation, of repeats about the line where they drift
    drift : a second, with its interval; None of fewer than three
    """

    values: tuple[float, ...]
    times: tuple[float, ...]
    mean: Estimate
    spread: float
    drift: Estimate | None

    @classmethod
    def of(cls, estimates: Sequence[Estimate], times: Sequence[float]) -> Repeats:
        """One number of each repeat, and when it was measured."""
        values, mean = tuple(one.value for one in estimates), mean_of(estimates)
        count = len(values)
        spread = float(np.std(values, ddof=1)) if count > 1 else 0.0
        since = np.asarray(times) - np.mean(times)
        if count < _FEWEST or not np.any(since):
            return cls(values, tuple(times), mean, spread, None)
        slope = float(since @ np.asarray(values)) / float(since @ since)
        left = np.asarray(values) - np.mean(values) - slope * since
        about = sqrt(float(left @ left) / (count - 2))
        half = _student(count - 2) * about / sqrt(float(since @ since))
        drift = Estimate(slope, slope - half, slope + half)
        drifts = not drift.low <= 0 <= drift.high
        return cls(values, tuple(times), mean, about if drifts else spread, drift)


def mean_of(estimates: Sequence[Estimate]) -> Estimate:
    """Mean of repeats; its interval holds theirs and the scatter."""
    if len(estimates) == 1:
        return estimates[0]
    values = [one.value for one in estimates]
    half = _student(len(values) - 1) * float(np.std(values, ddof=1)) / sqrt(len(values))
    mean = float(np.mean(values))
    low, high = min(one.low for one in estimates), max(one.high for one in estimates)
    return Estimate(mean, min(low, mean - half), max(high, mean + half))


def _student(freedom: int) -> float:
    from scipy.stats import t

    return float(t.ppf(_SURE, freedom))
