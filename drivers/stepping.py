"""The clock of a served virtual drive that steps, written through its own parameters."""

from __future__ import annotations

from collections.abc import Callable

from profiles.errors import AccessDenied, LinkError
from profiles.schema import Address, Profile

__all__ = ["set_simulation"]


def set_simulation(
    write: Callable[[Address, int], None], profile: Profile, name: str, seconds: float
) -> None:
    """Write `simulation_cycle` or `simulation_advance`; raises LinkError where there is none."""
    parameter = profile.parameters.get(name)
    if parameter is None:
        raise LinkError(
            f"clock=step needs a served virtual drive; profile '{profile.name}' has no '{name}'"
        )
    try:
        write(parameter.address, round(seconds / parameter.scale))
    except AccessDenied:
        raise LinkError(
            "the drive does not step: serve it with --clock step, or leave clock=step away"
        ) from None
