"""What an experiment is: a generator that yields a set-point and receives the sample after it.

Set-points are torque at the axis, N.m or N. An experiment has no clock and no I/O; time comes from
the samples. Experiments compose with `yield from` and return a result object.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace
from typing import TypeVar

from drivers.errors import PreflightRefused
from drivers.sample import Sample

__all__ = ["Context", "Plan", "come_to_rest", "stand"]

T = TypeVar("T")
Plan = Generator[float, Sample, T]

_REST_SAMPLES = 8
_REST_TIME = 0.02  # s
_STAND_TIME = 0.15  # s
_BEYOND_NOISE = 8.0  # rms: two samples, each up to four from the mean
_RMS_OF_MEDIAN_BEND = 0.605  # 1.48/√6, of white noise


def _silent(text: str) -> None:
    return None


@dataclass(frozen=True, slots=True)
class Context:
    """What every experiment on an axis needs to know.

    Attributes
    ----------
    cycle : s
    resolution : of the position, rad or m
    start : position about which the axis moves, rad or m
    travel : room on either side of `start`, rad or m
    torque : largest torque command, N.m or N
    speed : largest speed, rad/s or m/s
    rest : torque that holds the axis at rest, N.m or N
    torque_resolution : of the torque command, N.m or N
    noise : rms of the position at rest, rad or m
    position_unit, effort_unit : for messages
    tell, detail : called with a line about what happens now, and about a step's way
    """

    cycle: float
    resolution: float
    start: float
    travel: float
    torque: float
    speed: float
    rest: float = 0.0
    torque_resolution: float = 0.0
    noise: float = 0.0
    position_unit: str = "rad"
    effort_unit: str = "N.m"
    tell: Callable[[str], None] = field(default=_silent)
    detail: Callable[[str], None] = field(default=_silent)

    @property
    def motion(self) -> float:
        """Displacement that counts as motion.

        Some counts, and never below a share of the travel or what the noise does alone.
        """
        return max(5 * self.resolution, self.travel / 5000, _BEYOND_NOISE * self.noise)

    @property
    def still(self) -> float:
        """Displacement within which an axis stands still, rad or m."""
        return max(2.5 * self.resolution, 0.7 * _BEYOND_NOISE * self.noise)


def stand(context: Context) -> Plan[float]:
    """See that the axis stays where it is under the rest torque; raises PreflightRefused.

    Returns the rms of the position's noise, rad or m, by its second differences: those of an axis
    that falls are small.
    """
    sample = yield context.rest
    begin = before = sample
    bends: list[float] = []
    noise = 0.0
    while sample.time - begin.time < _STAND_TIME:
        earlier, before, sample = before, sample, (yield context.rest)
        insort(bends, abs(sample.position - 2 * before.position + earlier.position))
        noise = bends[len(bends) // 2] * _RMS_OF_MEDIAN_BEND
        moved = sample.position - begin.position
        if abs(moved) > replace(context, noise=noise).motion:
            raise PreflightRefused(
                f"the axis does not stay at rest with {context.rest:.4g} {context.effort_unit}: it "
                f"moved {moved:+.3g} {context.position_unit} within "
                f"{sample.time - begin.time:.3g} s. If a load pulls it, declare its brake, "
                "counterbalance or fixture in an axis file ([mechanics] held_by)",
                code="preflight.not-at-rest",
            )
    return noise


def come_to_rest(torque: float, context: Context, within: float = 5.0) -> Plan[Sample]:
    """Command `torque` until the position stands still; return the last sample.

    Still means: within two counts, or the noise, for some samples and 20 ms. Gives up after
    `within` s, for the envelope and the stop path to deal with.
    """
    sample = yield torque
    began = since = sample.time
    at, count = sample.position, 0
    while sample.time - began < within:
        sample = yield torque
        if abs(sample.position - at) > context.still:
            at, since, count = sample.position, sample.time, 0
        count += 1
        if count >= _REST_SAMPLES and sample.time - since >= _REST_TIME:
            break
    return sample
