"""The object dictionary of the virtual drive on CANopen, and what another drive's is made of."""

from __future__ import annotations

from dataclasses import dataclass, field

from drivers.virtual.mirror import Entry

__all__ = ["OWN", "SIMULATION", "Dictionary"]

VENDOR = 0x00007457
PRODUCT = 0x00000001
REVISION = 0x00010000


@dataclass(frozen=True)
class Dictionary:
    """Objects by (index, sub), texts by index, identity (1018h), and what is missing.

    `lacks`: communication objects (1010h, 1016h …) that this drive does not have.
    """

    objects: dict[tuple[int, int], Entry]
    identity: tuple[int, int, int] = (VENDOR, PRODUCT, REVISION)
    strings: dict[int, bytes] = field(default_factory=dict)
    lacks: frozenset[int] = frozenset()

    @property
    def counts(self) -> dict[int, int]:
        """Highest sub-index of every record."""
        found = {0x1010: 1, 0x1016: 1, 0x1018: 4, 0x1029: 1}
        for index, sub in self.objects:
            if sub:
                found[index] = max(sub, found.get(index, 0))
        return found


def _own(key: str, code: str, access: str = "rw", factor: float = 1.0) -> Entry:
    return Entry((key,), code, access, factor)


SIMULATION = {
    (0x1006, 0): _own("simulation_cycle", "I"),
    (0x2FF0, 0): _own("simulation_advance", "I"),
}

OWN = Dictionary(
    SIMULATION
    | {
        (0x2010, 1): _own("torque_offset", "h"),
        (0x2010, 2): _own("coulomb_positive", "H"),
        (0x2010, 3): _own("coulomb_negative", "H"),
        (0x2010, 4): _own("viscous_gain", "H"),
        (0x2010, 5): _own("coulomb_speed", "I"),
        (0x2011, 1): _own("velocity_gain", "I"),
        (0x2011, 2): _own("integral_time", "I"),
        (0x2011, 3): _own("position_gain", "I"),
        (0x2011, 4): _own("torque_lag", "I", "ro"),
        (0x2012, 1): _own("motor_temperature", "h", "ro"),
        (0x6007, 0): _own("abort_connection_option", "h"),
        (0x603F, 0): _own("error_code", "H", "ro"),
        (0x6040, 0): _own("controlword", "H"),
        (0x6041, 0): _own("statusword", "H", "ro"),
        (0x605A, 0): _own("quick_stop_option", "h"),
        (0x6060, 0): _own("mode", "b"),
        (0x6061, 0): _own("mode_display", "b", "ro"),
        (0x6064, 0): _own("position_actual", "i", "ro"),
        (0x6065, 0): _own("following_window", "I"),
        (0x606C, 0): _own("velocity_actual", "i", "ro"),
        (0x6071, 0): _own("torque_target", "h"),
        (0x6072, 0): _own("max_torque", "H"),
        (0x6076, 0): _own("rated_torque", "I", "ro", 1000),
        (0x6077, 0): _own("torque_actual", "h", "ro"),
        (0x607A, 0): _own("position_target", "i"),
        (0x6080, 0): _own("max_speed", "I", "rw", 10),
        (0x6087, 0): _own("torque_slope", "I"),
        (0x608F, 1): _own("encoder_increments", "I", "ro"),
        (0x608F, 2): _own("encoder_revolutions", "I", "ro"),
        (0x60FF, 0): _own("velocity_target", "i"),
        (0x6502, 0): _own("supported_modes", "I", "ro"),
    },
    strings={0x1008: b"tworelay virtual drive", 0x1009: b"none", 0x100A: b"1.0"},
)
