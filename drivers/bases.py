"""What a drive counts in.

Rated torque, position units a motor revolution, and which way it counts.
"""

from __future__ import annotations

from collections.abc import Callable
from math import nan

from drivers.errors import PreflightRefused
from drivers.scaling import Scaling
from profiles.address import Address, CanopenAddress
from profiles.axis import Axis
from profiles.parameter import Unit
from profiles.schema import Profile

__all__ = ["interpolation_period", "read_bases"]

_COUNTED_IN_RATED = {
    Unit.RATED_TORQUE, Unit.RATED_TORQUE_PER_SPEED, Unit.RATED_TORQUE_PER_SECOND, Unit.CURRENT,
}  # fmt: skip
_COUNTED_IN_INCREMENTS = {Unit.INCREMENT, Unit.INCREMENT_PER_SECOND}
_POSITION_TURNED, _VELOCITY_TURNED = 0x80, 0x40  # of 607Eh, polarity (CiA 402-2, 10.3.20)
_ENCODER, _RATED_TORQUE = 0x608F, 0x6076
_FACTORS = frozenset({"feed_units", "gear_motor_revolutions", "position_factor"})
_FEWEST = 200  # position units a revolution: fewer are a default that nobody has set
_LARGEST_PERIOD = 255  # 8 bits
_RATIO_TOLERANCE = 1e-6  # of two ratios that are one
_WAY_OUT = "give encoder (position units a motor revolution) in the axis file, or set up the drive"

Read = Callable[[str], int | None]  # raw value of a parameter by name; None: not there


def read_bases(profile: Profile, axis: Axis, read: Read) -> Scaling:
    """The scaling of a drive, from its own objects where the axis file does not say it.

    Raises PreflightRefused where it cannot be known, LinkError.
    """
    units = {parameter.unit for parameter in profile.parameters.values()}
    rated, encoder = axis.rated_torque, axis.encoder
    if rated is None and units & _COUNTED_IN_RATED:
        rated = _rated_torque(profile, read)
    if encoder is None and units & _COUNTED_IN_INCREMENTS:
        encoder = _encoder(profile, read)
    constant = _torque_constant(profile, axis, rated or nan, read)
    turned = _turned(profile, read)
    return Scaling(rated or nan, encoder or nan, axis.mechanics, constant, turned)


def interpolation_period(cycle: float) -> tuple[int, int]:
    """60C2h:01 and :02 of a cycle (s): so many times ten to that power.

    The finest that fits 8 bits.
    """
    exponent = -6
    while (told := round(cycle / 10**exponent)) > _LARGEST_PERIOD:
        exponent += 1
    # the usual way to say it: 5 ms are 5e-3, and not 50e-4
    while told % 10 == 0 and exponent < 0:
        told, exponent = told // 10, exponent + 1
    return told, exponent


def _torque_constant(profile: Profile, axis: Axis, rated: float, read: Read) -> float:
    """Motor torque constant, N.m/A, where a parameter is a current."""
    known = profile.parameters
    if not any(p.unit is Unit.CURRENT for name, p in known.items() if name != "rated_current"):
        return 0.0
    if axis.torque_constant is not None:
        return axis.torque_constant
    base = known.get("rated_current")
    current = base.number(read("rated_current") or 0) * base.scale if base is not None else 0.0
    if current <= 0:
        raise PreflightRefused(
            f"profile '{profile.name}' has parameters in A, and the motor's rated current is not "
            "known",
            code="scale.current",
            hint="give torque_constant (N.m/A) in the axis file",
        )
    return rated / current


def _rated_torque(profile: Profile, read: Read) -> float:
    """Motor rated torque, N.m (6076h)."""
    base = profile.parameters.get("rated_torque")
    if base is None:
        raise PreflightRefused(
            f"profile '{profile.name}' has no rated torque, so the torque scale is unknown",
            code="scale.torque",
            hint="give rated_torque (N.m of the motor) in the axis file",
        )
    told = read("rated_torque")
    if told is None:
        raise PreflightRefused(
            f"the drive does not tell its rated torque ({base.address}), so its torque scale is "
            "unknown",
            code="scale.torque",
            hint="give rated_torque (N.m of the motor) in the axis file",
        )
    rated = base.number(told) * base.scale
    is_standard = isinstance(base.address, CanopenAddress) and base.address.index == _RATED_TORQUE
    if is_standard and told == 1:
        raise PreflightRefused(
            f"the drive's rated torque (6076h) reads 1, that is {rated:g} N.m, as drives do whose "
            "motor is not set up: its torque scale is unknown",
            code="scale.torque",
            hint="set up the motor data in the drive, or give rated_torque in the axis file",
        )
    if rated <= 0:
        raise PreflightRefused(
            f"the drive's rated torque ({base.address}) is {rated:g} N.m, so its torque scale is "
            "unknown",
            code="scale.torque",
            hint="set up the motor data in the drive, or give rated_torque in the axis file",
        )
    return rated


def _encoder(profile: Profile, read: Read) -> float:
    """Position encoder resolution, position units a motor revolution (608Fh)."""
    known = profile.parameters
    if "encoder_increments" not in known:
        raise PreflightRefused(
            f"profile '{profile.name}' has no encoder resolution, so the position scale is unknown",
            code="scale.position",
            hint="give encoder (increments per motor revolution) in the axis file",
        )
    address = known["encoder_increments"].address
    told = read("encoder_increments")
    increments = None if told is None else known["encoder_increments"].number(told)
    revolutions = read("encoder_revolutions") if "encoder_revolutions" in known else 1
    encoder = None
    if increments is not None:
        encoder = _positive(
            increments, 1 if revolutions is None else revolutions, "encoder resolution"
        )
    is_standard = isinstance(address, CanopenAddress) and address.index == _ENCODER
    if is_standard or _FACTORS & known.keys():
        return _by_factors(encoder, read)
    if encoder is None:
        raise PreflightRefused(
            f"the drive does not tell its encoder resolution ({address}), so its position scale is "
            "unknown",
            code="scale.position",
            hint="give encoder (increments per motor revolution) in the axis file",
        )
    return encoder


def _by_factors(encoder: float | None, read: Read) -> float:
    """Position units a motor revolution, by the factor group of CiA 402-2; `encoder`: by 608Fh."""
    feed = _ratio(read, "feed_units", "feed_revolutions", "feed constant")
    gear = _ratio(read, "gear_motor_revolutions", "gear_shaft_revolutions", "gear ratio")
    factor = _ratio(read, "position_factor", "position_divisor", "position factor")
    found = encoder
    if feed is not None:
        found = feed / (gear or 1.0)
    if factor is not None and encoder is not None:  # of the standard's first edition
        old = encoder / factor
        if feed is not None and found is not None and abs(old / found - 1) > _RATIO_TOLERANCE:
            raise PreflightRefused(
                f"the drive's objects contradict each other: 608Fh and 6093h make {old:g} position "
                f"units a motor revolution, 6092h and 6091h {found:g}; {_WAY_OUT}",
                code="scale.contradiction",
            )
        found = old
    if found is None:
        raise PreflightRefused(
            "the drive does not tell its encoder resolution (608Fh:01), nor a feed constant "
            "(6092h), so its position scale is unknown",
            code="scale.position",
            hint="give encoder (position units a motor revolution) in the axis file",
        )
    if found < _FEWEST and encoder is not None and encoder > found:
        raise PreflightRefused(
            f"by 6092h and 6091h a motor revolution has {found:g} position units, by 608Fh "
            f"{encoder:g} increments: is 6092h set up, or as it was delivered? "
            f"{_WAY_OUT[0].upper()}{_WAY_OUT[1:]}",
            code="scale.position-units",
        )
    return found


def _ratio(read: Read, above: str, below: str, what: str) -> float | None:
    """A ratio of two objects; None where the drive does not have it."""
    numerator, denominator = read(above), read(below)
    if numerator is None or denominator is None:
        return None
    return _positive(numerator, denominator, what)


def _positive(numerator: float, denominator: float, what: str) -> float:
    if numerator <= 0 or denominator <= 0:
        raise PreflightRefused(
            f"the drive's {what} is {numerator}/{denominator}: its position scale is unknown",
            code="scale.position",
            hint="set it up in the drive, or give encoder in the axis file",
        )
    return numerator / denominator


def _turned(profile: Profile, read: Read) -> frozenset[Address]:
    """Where the parameters are that the drive counts against its motor, by its polarity (607Eh)."""
    polarity = read("polarity") or 0
    names: list[str] = []
    if polarity & _POSITION_TURNED:
        names += ["position_actual", "position_target"]
    if polarity & _VELOCITY_TURNED:
        names += ["velocity_actual", "velocity_target"]
    known = profile.parameters
    return frozenset(known[name].address for name in names if name in known)
