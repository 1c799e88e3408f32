"""Signals whose integrals are exact: a torque held between commands, a sign between reversals.

A position sampled at t₀ < t₁ < … is tied to the acceleration without any derivative:

    (y_{k+1} − y_k)/h_k − (y_k − y_{k−1})/h_{k−1} = ∫ Λ_k(t)·ÿ(t) dt

with Λ_k the hat function of node k. The same divided second difference of the double integral of
any other signal gives its hat moment ∫ Λ_k·s dt. So an equation of motion holds between hat moments
exactly, however irregular the samples are.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Steps", "hat_moments"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


class Steps:
    """A piecewise constant signal and its integrals from its first break.

    Parameters
    ----------
    breaks : (n,) s, increasing; `values[k]` holds from `breaks[k]` on
    values : (n,); the first holds before the first break, too
    """

    __slots__ = ("_first", "_second", "breaks", "values")

    def __init__(self, breaks: Array, values: Array) -> None:
        self.breaks = breaks
        self.values = values
        widths = np.diff(breaks)
        self._first = np.concatenate(([0.0], np.cumsum(values[:-1] * widths)))
        pieces = (self._first[:-1] + 0.5 * values[:-1] * widths) * widths
        self._second = np.concatenate(([0.0], np.cumsum(pieces)))

    @classmethod
    def sign(cls, begin: float, first: int, changes: Array) -> Steps:
        """`first` (+1 or −1) from `begin` on, and the other one after each of `changes`, s."""
        values = first * (-1.0) ** np.arange(len(changes) + 1)
        earliest = min(begin, float(changes[0])) if len(changes) else begin
        return cls(np.concatenate(([earliest], changes)), np.asarray(values, np.float64))

    def _piece(self, time: Array) -> tuple[NDArray[Any], Array]:
        k = np.maximum(np.searchsorted(self.breaks, time, side="right") - 1, 0)
        return k, time - self.breaks[k]

    def at(self, time: Array) -> Array:
        """Value, (n,)."""
        result: Array = self.values[self._piece(time)[0]]
        return result

    def integral(self, time: Array) -> Array:
        """∫ from the first break, (n,)."""
        k, x = self._piece(time)
        result: Array = self._first[k] + self.values[k] * x
        return result

    def fourier(self, starts: Array, period: float, harmonics: NDArray[Any]) -> Complex:
        """Coefficients over the periods that begin at `starts`, each about its own begin, exactly.

        (periods, harmonics); a cosine of half-swing a has the coefficient a.
        """
        found = np.zeros((len(starts), len(harmonics)), complex)
        angle = 2j * np.pi / period * harmonics
        for row, start in enumerate(starts):
            inside = self.breaks[(self.breaks > start) & (self.breaks < start + period)]
            edges = np.concatenate(([start], inside, [start + period]))
            values = self.at(0.5 * (edges[1:] + edges[:-1]))
            turned = np.exp(-np.outer(edges - start, angle))
            found[row] = 2 / period * (values @ ((turned[:-1] - turned[1:]) / angle))
        return found

    def double_integral(self, time: Array) -> Array:
        """∬ from the first break, (n,)."""
        k, x = self._piece(time)
        result: Array = self._second[k] + (self._first[k] + 0.5 * self.values[k] * x) * x
        return result


def hat_moments(time: Array, double_integral: Array) -> Array:
    """∫ Λ_k·s dt at the inner nodes, (n−2,), from the double integral of s at all nodes, (n,)."""
    slopes = np.diff(double_integral) / np.diff(time)
    return np.diff(slopes)
