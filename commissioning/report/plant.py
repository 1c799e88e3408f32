"""The identified rigid axis as a frequency response."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from commissioning.result.found import Found

__all__ = ["response_of"]


def response_of(found: Found, frequency: NDArray[np.float64]) -> NDArray[np.complex128]:
    """G(jω) = e^(−jωτ)/(J(jω)² + Bjω), rad/(N.m) or m/N, at `frequency` (n,), rad/s.

    The inertia must be known and above zero.
    """
    j, b, tau = (q.value if q else 0.0 for q in (found.inertia, found.viscous, found.dead_time))
    s = 1j * frequency
    response: NDArray[np.complex128] = np.exp(-s * tau) / (j * s**2 + b * s)
    return response
