"""The clock of a served virtual drive that steps, written through its own objects."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from drivers.errors import AccessDenied, LinkError
from profiles.address import Address, CanopenAddress, ModbusAddress
from profiles.schema import Profile

__all__ = ["TWIN_MARK", "TWIN_MARKED", "Simulation", "set_simulation"]

Simulation = Literal["simulation_cycle", "simulation_advance"]

# where a twin of another drive has them, in us
_TWIN: dict[tuple[str, str], Address] = {
    ("canopen", "simulation_cycle"): CanopenAddress(index=0x1006, type="u32"),
    ("canopen", "simulation_advance"): CanopenAddress(index=0x2FF0, type="u32"),
    ("modbus", "simulation_cycle"): ModbusAddress.model_validate(
        {"register": 0xFF00, "type": "u32"}
    ),
    ("modbus", "simulation_advance"): ModbusAddress.model_validate(
        {"register": 0xFF02, "type": "u32"}
    ),
}
_MICROSECOND = 1e-6
TWIN_MARK = ModbusAddress.model_validate({"register": 0xFF04, "type": "u16"})  # where one says so
TWIN_MARKED = 0x7457


def set_simulation(
    write: Callable[[Address, int], None],
    profile: Profile,
    name: Simulation,
    seconds: float,
    is_twin: Callable[[], bool],
) -> None:
    """Let the drive's own clock know; raises LinkError where it has none.

    `is_twin` : whether the drive says that it is a virtual one, asked where the profile is another
        drive's
    """
    parameter = profile.parameters.get(name)
    if parameter is not None:
        address, scale = parameter.address, parameter.scale
    elif is_twin():
        address, scale = _TWIN[profile.bus, name], _MICROSECOND
    else:
        raise LinkError(
            f"clock=step needs a served virtual drive; profile '{profile.name}' has no '{name}'",
            code="link.no-step",
        )
    try:
        write(address, round(seconds / scale))
    except AccessDenied:
        raise LinkError(
            "the drive does not step: serve it with --clock step, or leave clock=step away",
            code="link.no-step",
        ) from None
