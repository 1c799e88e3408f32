"""The torque that balances the load, found in position mode: creep up, creep down, and average.

An axis that its friction cannot hold must not meet zero torque. While it creeps, the drive gives
load + friction one way and load − friction the other; at rest it gives anything between them.
"""

from __future__ import annotations

from commissioning.experiments.plan import Context, Plan
from drivers.errors import PreflightRefused

__all__ = ["balancing_torque"]

_DISTANCE = 0.01  # of the travel
_TIME = 0.6  # s, one way


def balancing_torque(context: Context) -> Plan[float]:
    """Holding torque, N.m or N. Set-points are positions, rad or m."""
    distance = max(_DISTANCE * context.travel, 100 * context.resolution)
    way = round(_TIME / context.cycle)
    means = []
    for begin, end in ((0.0, distance), (distance, 0.0)):
        torques = []
        for n in range(1, way + 1):
            sample = yield context.start + begin + (end - begin) * n / way
            if n > way // 2:
                torques.append(sample.torque)
        means.append(sum(torques) / len(torques))
    if abs(means[0] + means[1]) / 2 >= context.torque:
        raise PreflightRefused(
            f"holding the load takes {sum(means) / 2:.4g} {context.effort_unit}, more than the "
            f"limit of {context.torque:.4g} {context.effort_unit}",
            code="preflight.load",
            hint="raise --max-torque",
        )
    return sum(means) / 2
