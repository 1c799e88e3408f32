"""How robust a loop is: margins, maximum sensitivity, bandwidth, stability; of the sampled loop, exactly."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import NDArray

from commissioning.tuning.controllers import Gains, transfer
from commissioning.tuning.plant import LoopPlant
from commissioning.tuning.rules import Cascade

__all__ = ["LEAST_MARGIN", "MOST_SENSITIVITY", "Margins", "margins"]

Array = NDArray[np.float64]

LEAST_MARGIN, MOST_SENSITIVITY = 30.0, 2.5  # degrees, Ms: a set beyond is never proposed

_GRID = 6000
_LOWEST = 1e-4  # of the crossover, roughly: where the integral part is alone
_BAND = 1 / 2**0.5


@dataclass(frozen=True, slots=True)
class Margins:
    """Of one loop, broken at the plant's input.

    Attributes
    ----------
    stable : all poles of the closed loop lie inside the unit circle
    phase : degrees, the smallest at any crossover of |L| = 1; negative where the loop is unstable
    gain_db : by how much the gain may rise until the loop is unstable, dB; None: as much as one likes
    sensitivity : Ms = max |1/(1 + L)|
    crossover : rad/s, of the smallest phase margin; None: |L| never passes 1
    bandwidth : rad/s, up to which |L/(1 + L)| stays above −3 dB; None where it never does
    """

    stable: bool
    phase: float | None
    gain_db: float | None
    sensitivity: float
    crossover: float | None
    bandwidth: float | None

    @property
    def sound(self) -> bool:
        """Whether gains with these margins may be proposed."""
        return (
            self.stable
            and self.phase is not None
            and self.phase >= LEAST_MARGIN
            and self.sensitivity <= MOST_SENSITIVITY
        )


def margins(plant: LoopPlant, gains: Gains) -> Margins:
    """Margins of `gains` on `plant`."""
    p_top, p_below = plant.polynomials()
    c_top, c_below = transfer(gains, plant.cycle)
    top, below = np.polymul(p_top, c_top), np.polymul(p_below, c_below)
    poles = np.roots(np.polyadd(top, below))
    if isinstance(gains, Cascade) and not gains.position_gain:
        poles = np.delete(poles, np.argmin(np.abs(poles - 1)))  # where the axis stands is left open
    stable = bool(np.all(np.abs(poles) < 1))
    highest = pi / plant.cycle
    w = np.geomspace(_lowest(plant), highest, _GRID)
    z = np.exp(1j * w * plant.cycle)
    loop = np.polyval(top, z) / np.polyval(below, z)
    size, angle = np.abs(loop), np.unwrap(np.angle(loop))
    # the integrators of plant and controller: −90° each at the lowest frequency
    angle -= 2 * pi * round((angle[0] + pi) / (2 * pi))
    crossings = _crossings(np.log(size), w)
    phase = crossover = None
    if len(crossings):
        turned = np.degrees(np.interp(np.log(crossings), np.log(w), angle))
        away = (turned + 180 + 180) % 360 - 180
        worst = int(np.argmin(np.abs(away)))
        # what is missing to −180°, signed by whether the loop is stable
        phase = float(abs(away[worst]) if stable else -abs(away[worst]))
        crossover = float(crossings[worst])
    closed = np.abs(loop / (1 + loop))
    above = np.flatnonzero(closed >= _BAND)
    return Margins(
        stable,
        phase,
        _gain_margin(size, angle, w) if stable else None,
        float(np.max(1 / np.abs(1 + loop))),
        crossover,
        float(w[above[-1]]) if len(above) else None,
    )


def _lowest(plant: LoopPlant) -> float:
    return _LOWEST / max(plant.delay, plant.cycle)


def _crossings(values: Array, w: Array) -> Array:
    """Where `values` change sign, by straight lines over log ω, rad/s."""
    at = np.flatnonzero(values[:-1] * values[1:] < 0)
    share = values[at] / (values[at] - values[at + 1])
    return np.asarray(np.exp(np.log(w[at]) + share * np.log(w[at + 1] / w[at])), np.float64)


def _gain_margin(size: Array, angle: Array, w: Array) -> float | None:
    """Smallest rise of the gain, dB, that brings |L| to 1 where the phase is an odd multiple of 180°."""
    turns = np.floor((angle + pi) / (2 * pi))
    found = []
    for k in np.flatnonzero(np.diff(turns)):
        level = max(turns[k], turns[k + 1]) * 2 * pi - pi
        share = (level - angle[k]) / (angle[k + 1] - angle[k])
        found.append(float(np.log(size[k]) + share * np.log(size[k + 1] / size[k])))
    rises = [-20 * value / np.log(10) for value in found if value < 0]
    return float(min(rises)) if rises else None
