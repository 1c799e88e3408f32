"""Describing functions of the relay, of friction, and of both together.

Amplitude is always the half-swing of the position, and relay amplitude half of the relay's swing.
Source: Blaha 2001, equation numbers as there; method.md section 8 lists its misprints.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from commissioning.identification.errors import NotShown

__all__ = ["equivalent", "inverse_locus", "relay"]

Complex = NDArray[np.complex128]


def relay(half_swing: ArrayLike, relay_amplitude: float, hysteresis: float) -> Complex:
    """Describing function of a relay with hysteresis, 4d/(πA)·e^(−j·asin(ε/A)).

    Parameters
    ----------
    half_swing : A, half of the position's peak-to-peak swing, rad or m; at least `hysteresis`
    relay_amplitude : d, half of the relay's swing, N.m or N
    hysteresis : ε, half-width, rad or m

    Returns
    -------
    complex array, N.m/rad or N/m
    """
    a = np.asarray(half_swing, float)
    _check(a, hysteresis)
    phasor = np.exp(-1j * np.arcsin(hysteresis / a))
    return np.asarray(4 * relay_amplitude / (np.pi * a) * phasor, np.complex128)


def equivalent(
    half_swing: ArrayLike, relay_amplitude: float, hysteresis: float, coulomb: complex
) -> Complex:
    """Equivalent nonlinearity of relay and Coulomb friction together (4.7).

    N = 4/(πA)·( d·e^(−j·asin(ε/A)) + j·f ); `coulomb` may be the complex f̄ of (4.14).
    """
    a = np.asarray(half_swing, float)
    friction: Any = 4j * coulomb / (np.pi * a)
    total: Any = relay(a, relay_amplitude, hysteresis) + friction
    return np.asarray(total, np.complex128)


def inverse_locus(
    half_swing: ArrayLike, relay_amplitude: float, hysteresis: float, coulomb: float
) -> Complex:
    """−1/N of relay and friction (4.10), with the factor 1/d that the source lacks."""
    a = np.asarray(half_swing, float)
    _check(a, hysteresis)
    share, ratio = hysteresis / a, coulomb / relay_amplitude
    top = np.sqrt(1 - share**2) - 1j * (ratio - share)
    below = 1 - 2 * ratio * share + ratio**2
    locus: Any = -np.pi * a / (4 * relay_amplitude) * top / below
    return np.asarray(locus, np.complex128)


def _check(half_swing: NDArray[Any], hysteresis: float) -> None:
    if np.any(half_swing < hysteresis) or np.any(half_swing <= 0):
        raise NotShown("half-swing is below the hysteresis: such a relay never switches")
