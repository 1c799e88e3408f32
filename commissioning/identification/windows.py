"""Windows over a record, and the weighted least squares of what they see.

A window is sin⁴ at the samples and straight between them; neighbours overlap, so periods, not
windows, are what a jackknife or a held-out residual leaves out.
"""

from __future__ import annotations

from functools import cached_property
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["LONGEST_DELAY", "MEAN_WEIGHT", "NARROWEST", "Problem", "Windows"]

Array = NDArray[np.float64]

_SHIFT = 0.1  # of a window's width
MEAN_WEIGHT = 0.375  # of sin⁴
NARROWEST = 6  # samples in a window
LONGEST_DELAY, _LONGEST_LEAD = 0.25, 0.5  # of the period, and s


class Windows:
    """sin⁴ windows of all widths over the inner samples, as a sparse matrix.

    Attributes
    ----------
    noise : (n,) what white noise of unit rms in the position makes in J = 1 times each row
    centre, width : (n,) s
    is_wide, is_narrow : (n,) whether a row belongs to the widest, to the narrowest windows
    narrow : the rows of the narrowest alone
    """

    def __init__(
        self, time: Array, shares: tuple[float, ...], period: float, step: float, rests: Array
    ) -> None:
        from scipy.sparse import csr_array

        inner = time[1:-1]
        begins: list[Array] = []
        widths: list[Array] = []
        lead = min(LONGEST_DELAY * period, _LONGEST_LEAD)
        for share in shares:
            width = max(share * period, NARROWEST * step)
            starts = np.arange(time[0] + lead, time[-1] - width, _SHIFT * width)
            for rest_begin, rest_end in rests:  # windows in which the axis rests tell nothing
                starts = starts[(starts + width < rest_begin) | (starts > rest_end)]
            begins.append(starts)
            widths.append(np.full(len(starts), width))
        begin, width_of = np.concatenate(begins), np.concatenate(widths)
        first = np.searchsorted(inner, begin)
        last = np.searchsorted(inner, begin + width_of)
        counts = last - first
        pointers = np.concatenate(([0], np.cumsum(counts)))
        rows = np.repeat(np.arange(len(begin)), counts)
        columns = np.arange(pointers[-1]) - np.repeat(pointers[:-1] - first, counts)
        x = (inner[columns] - begin[rows]) / width_of[rows]
        phi = np.sin(np.pi * x) ** 4
        self._matrix = csr_array((phi, columns, pointers), shape=(len(begin), len(inner)))
        self.is_narrow = width_of == (width_of.min() if len(width_of) else 0.0)
        self.narrow = self._matrix[np.flatnonzero(self.is_narrow)]
        # rms of Σ φ_k·D_k for white noise in y: the norm of D^T·φ, from sin⁴'s second derivative
        mean_square = 4 * np.pi**4  # of φ'' for unit width
        self.noise = np.sqrt(mean_square * step / width_of**3)
        self.centre = begin + 0.5 * width_of
        self.width = width_of
        self.is_wide = width_of == width_of.max() if len(width_of) else np.zeros(0, bool)

    def __len__(self) -> int:
        return len(self.centre)

    def __matmul__(self, moments: Array) -> Array:
        result: Array = self._matrix @ moments
        return result


class Problem:
    """Weighted least squares.

    Columns inertia, viscous, offset, the law's terms, change of dead time.
    """

    def __init__(self, left: Array, right: Array, weights: Array) -> None:
        self._weights = weights
        self._left = left * weights[:, None]
        self._right = right * weights
        self._scale = np.linalg.norm(self._left, axis=0)
        self._scale[self._scale == 0] = 1.0

    def solve(self, rows: Any = slice(None), columns: Any = slice(None)) -> Array:
        """Solution of some rows for some columns."""
        scale = self._scale[columns]
        a = self._left[rows][:, columns] / scale
        solution, *_ = np.linalg.lstsq(a, self._right[rows], rcond=None)
        result: Array = solution / scale
        return result

    @property
    def condition(self) -> float:
        """Condition number of the scaled matrix."""
        return float(np.linalg.cond(self._left / self._scale))

    @property
    def residual(self) -> float:
        """Relative residual of the solution."""
        rest = self._right - self._left @ self.solution
        return float(np.linalg.norm(rest) / np.linalg.norm(self._right))

    @cached_property
    def solution(self) -> Array:
        """Of all rows."""
        return self.solve()

    def without_delay(self) -> float:
        """Relative residual with the dead time as it is."""
        solution = self.solve(columns=slice(0, -1))
        rest = self._right - self._left[:, :-1] @ solution
        return float(np.linalg.norm(rest) / np.linalg.norm(self._right))

    def explained_by(self, columns: Array, rows: NDArray[np.bool_]) -> float:
        """Share of the residual's square of some rows that further columns take away.

        `columns` : (rows, k) before weighting
        """
        more = columns * self._weights[rows][:, None]
        a = self._left[rows] / self._scale
        rest = self._right[rows] - self._left[rows] @ self.solution
        more = more - a @ np.linalg.lstsq(a, more, rcond=None)[0]
        left = rest - more @ np.linalg.lstsq(more, rest, rcond=None)[0]
        return 1 - float(left @ left) / float(rest @ rest)

    def held_out(self, periods: NDArray[Any]) -> float:
        """Relative residual on the odd periods of a fit to the even ones, and vice versa."""
        odd = periods % 2 == 1
        if odd.all() or not odd.any():
            return float("inf")
        square = 0.0
        for fitted, left_out in ((odd, ~odd), (~odd, odd)):
            rest = self._right[left_out] - self._left[left_out] @ self.solve(fitted)
            square += float(rest @ rest)
        return sqrt(square) / float(np.linalg.norm(self._right))

    def jackknife(self, periods: NDArray[Any]) -> Array:
        """Covariance of the solution by leaving out one period at a time.

        Neighbouring windows overlap, so rows are no independent data; periods nearly are.
        """
        a, b = self._left / self._scale, self._right
        whole, moment = a.T @ a, a.T @ b
        numbers = np.unique(periods)
        found = []
        for number in numbers:
            rows = periods == number
            part = a[rows]
            found.append(
                np.linalg.lstsq(whole - part.T @ part, moment - part.T @ b[rows], rcond=None)[0]
            )
        count = len(numbers)
        if count < 3:
            return np.full((a.shape[1], a.shape[1]), np.inf)
        spread = np.array(found) - np.mean(found, axis=0)
        small = 1 + 3 / count  # Student's t over 2 for so few periods, about
        covariance: Array = (count - 1) / count * spread.T @ spread * small**2
        return covariance / np.outer(self._scale, self._scale)
