"""How robust a loop is: margins, maximum sensitivity, bandwidth, stability.

Of the sampled loop, exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, pi

import numpy as np
from numpy.typing import NDArray

from commissioning.tuning.controllers import Gains, response
from commissioning.tuning.plant import LoopPlant
from commissioning.tuning.rules import Cascade

__all__ = ["LEAST_MARGIN", "MOST_SENSITIVITY", "Margins", "margins"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

LEAST_MARGIN, MOST_SENSITIVITY = 30.0, 2.5  # degrees, Ms: a set beyond is never proposed

_GRID = 8000
_LOWEST = 1e-3  # of the slowest corner: where the integrators are alone
_SLOWEST = 1e-9  # of a radian a cycle: a corner below is one at zero
_BAND = 1 / 2**0.5


@dataclass(frozen=True, slots=True)
class Margins:
    """Margins of one loop, broken at the plant's input.

    Attributes
    ----------
    stable : all poles of the closed loop lie inside the unit circle
    phase : degrees, the smallest at any crossover of |L| = 1; negative where the loop is unstable
    gain_db : by how much the gain may rise until the loop is unstable, dB; None: as much as one
        likes
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
    w = np.geomspace(_lowest(plant, gains), pi / plant.cycle, _GRID)
    loop = plant.response(w) * response(gains, plant.cycle, w)
    stable = _is_stable(loop, _integrators(plant, gains))
    size, angle = np.abs(loop), np.unwrap(np.angle(loop))
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
        _gain_margin(size, angle) if stable else None,
        float(np.max(1 / np.abs(1 + loop))),
        crossover,
        float(w[above[-1]]) if len(above) else None,
    )


def _lowest(plant: LoopPlant, gains: Gains) -> float:
    """A frequency well below every corner of the loop, rad/s."""
    corners = [1 / plant.delay, plant.viscous / plant.inertia]
    if isinstance(gains, Cascade):
        corners += [gains.position_gain, gains.velocity_gain / plant.inertia]
    else:
        corners.append((gains.gain / plant.inertia) ** 0.5)
        corners.append(1 / gains.derivative_time if gains.derivative_time else 0.0)
    corners.append(1 / gains.integral_time if isfinite(gains.integral_time) else 0.0)
    slowest = _SLOWEST / plant.cycle
    return _LOWEST * min([pi / plant.cycle, *(c for c in corners if c > slowest)])


def _integrators(plant: LoopPlant, gains: Gains) -> int:
    """Poles of the open loop at z = 1.

    That of a position which a velocity loop leaves open is not counted.
    """
    slowest = _SLOWEST / plant.cycle
    count = 1 if plant.viscous / plant.inertia > slowest else 2
    count += isfinite(gains.integral_time) and 1 / gains.integral_time > slowest
    return count - (isinstance(gains, Cascade) and not gains.position_gain)


def _is_stable(loop: Complex, integrators: int) -> bool:
    """Nyquist's criterion on the upper half of the unit circle.

    1 + L is the closed loop's polynomial over the open one's. Along the half circle a pole inside
    turns by π, one at z = 1 by π/2, one outside not at all; the open loop has `integrators` at z =
    1 and none outside. So a stable loop turns 1 + L by π/2 an integrator, and each pole outside
    takes π off.
    """
    turn = np.unwrap(np.angle(1 + loop))
    missing = integrators * pi / 2 - float(turn[-1] - turn[0])
    return bool(abs(missing) < pi / 2)


def _crossings(values: Array, w: Array) -> Array:
    """Where `values` change sign, by straight lines over log ω, rad/s."""
    at = np.flatnonzero(values[:-1] * values[1:] < 0)
    share = values[at] / (values[at] - values[at + 1])
    return np.asarray(np.exp(np.log(w[at]) + share * np.log(w[at + 1] / w[at])), np.float64)


def _gain_margin(size: Array, angle: Array) -> float | None:
    """Smallest rise of the gain, dB, to |L| = 1 where the phase is an odd multiple of 180°."""
    turns = np.floor((angle + pi) / (2 * pi))
    found = []
    for k in np.flatnonzero(np.diff(turns)):
        level = max(turns[k], turns[k + 1]) * 2 * pi - pi
        share = (level - angle[k]) / (angle[k + 1] - angle[k])
        found.append(float(np.log(size[k]) + share * np.log(size[k + 1] / size[k])))
    rises = [-20 * value / np.log(10) for value in found if value < 0]
    return float(min(rises)) if rises else None
