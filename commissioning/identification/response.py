"""Response of a rigid axis with viscous friction to a torque held in small pieces, in closed form.

J·v̇ + B·v = T(t),  ẏ = v,  from rest at 0
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Response"]

Array = NDArray[np.float64]

_SMALL = 1e-3  # of a time constant: below, series are more exact than quotients
_BLOCK = 200.0  # time constants after which a running sum of exponentials begins anew


class Response:
    """Exact at every instant.

    Parameters
    ----------
    edges : (n+1,) s
    torque : (n,) N.m or N, between them
    inertia, viscous : kg.m2 or kg, N.m.s/rad or N.s/m; a negative viscous friction counts as none
    """

    def __init__(self, edges: Array, torque: Array, inertia: float, viscous: float) -> None:
        self._edges = edges
        self._rate = max(viscous / inertia, 0.0)
        self._acceleration = torque / inertia
        widths = np.diff(edges)
        decay, first, second, third = self._kernels(widths)
        self._speed = self._speeds(widths, decay, self._acceleration * first)
        steps = self._speed[:-1] * first + self._acceleration * second
        self._position = np.concatenate(([0.0], np.cumsum(steps)))
        areas = self._position[:-1] * widths + self._speed[:-1] * second
        areas += self._acceleration * third
        self._area = np.concatenate(([0.0], np.cumsum(areas)))

    def _kernels(self, time: Array) -> tuple[Array, Array, Array, Array]:
        """e^(−bt), and its first, second and third integral from 0, b = B/J."""
        b = self._rate
        z = b * time
        decay = np.exp(-z)
        if b == 0.0 or float(np.max(z, initial=0.0)) < _SMALL:
            first = time * (1 - z / 2 * (1 - z / 3))
            second = time**2 / 2 * (1 - z / 3 * (1 - z / 4))
            return decay, first, second, time**3 / 6 * (1 - z / 4 * (1 - z / 5))
        first = -np.expm1(-z) / b
        small = z < _SMALL
        second = np.where(small, time**2 / 2 * (1 - z / 3 * (1 - z / 4)), (time - first) / b)
        third = np.where(small, time**3 / 6 * (1 - z / 4 * (1 - z / 5)), (time**2 / 2 - second) / b)
        return decay, first, second, third

    def _speeds(self, widths: Array, decay: Array, gains: Array) -> Array:
        """Speed at the edges, v ← v·decay + gain, as sums in blocks that cannot overflow."""
        if self._rate == 0.0:
            return np.concatenate(([0.0], np.cumsum(gains)))
        speed = np.zeros(len(widths) + 1)
        exponent = np.concatenate(([0.0], np.cumsum(widths * self._rate)))
        begin, v = 0, 0.0
        while begin < len(widths):
            end = int(np.searchsorted(exponent, exponent[begin] + _BLOCK, side="right")) - 1
            end = max(end, begin + 1)
            if end == begin + 1:
                speed[end] = v * decay[begin] + gains[begin]
            else:
                grown = np.exp(exponent[begin + 1 : end + 1] - exponent[begin])
                sums = v + np.cumsum(gains[begin:end] * grown)
                speed[begin + 1 : end + 1] = sums / grown
            begin, v = end, float(speed[end])
        return speed

    def _piece(self, time: Array) -> tuple[NDArray[Any], Array]:
        last = len(self._acceleration) - 1
        k = np.clip(np.searchsorted(self._edges, time, side="right") - 1, 0, last)
        return k, np.maximum(time - self._edges[k], 0.0)

    def speed(self, time: Array) -> Array:
        """v, (n,) rad/s or m/s."""
        k, x = self._piece(time)
        decay, first, _, _ = self._kernels(x)
        return np.asarray(self._speed[k] * decay + self._acceleration[k] * first, np.float64)

    def position(self, time: Array) -> Array:
        """y, (n,) rad or m."""
        k, x = self._piece(time)
        _, first, second, _ = self._kernels(x)
        return np.asarray(
            self._position[k] + self._speed[k] * first + self._acceleration[k] * second,
            np.float64,
        )

    def area(self, time: Array) -> Array:
        """∫y from the first edge, (n,) rad.s or m.s."""
        k, x = self._piece(time)
        _, _, second, third = self._kernels(x)
        return np.asarray(
            self._area[k]
            + self._position[k] * x
            + self._speed[k] * second
            + self._acceleration[k] * third,
            np.float64,
        )
