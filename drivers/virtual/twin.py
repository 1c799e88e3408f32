"""A drive that behaves by another drive's map: its twin.

The objects or registers, their types and units are the profile's; what they do is the virtual
firmware's. A twin cannot show that its profile is wrong: it is to rehearse on, and to try every
profile from end to end.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

from drivers.virtual.axes import VirtualAxis
from drivers.virtual.device import Device
from drivers.virtual.dictionary import SIMULATION, Dictionary
from drivers.virtual.firmware import Firmware
from drivers.virtual.habits import NONE, Habits
from drivers.virtual.habitual_slave import bent
from drivers.virtual.mirror import Entry, Mirror
from drivers.virtual.objects import (
    MODE_CYCLIC_POSITION,
    MODE_CYCLIC_TORQUE,
    MODE_PROFILE_TORQUE,
    MODES,
)
from drivers.virtual.registers import CLOCK, Layout, RegisterMap
from drivers.virtual.switchgear import Switchgear
from profiles.address import CanopenAddress, MailboxAddress, ModbusAddress
from profiles.errors import UsageError
from profiles.parameter import Parameter, Protection, Unit
from profiles.procedures import Mode
from profiles.schema import Profile

__all__ = ["habits_of_twin", "modbus_twin", "twin", "within"]

_TURN = 6.283185307179586  # rad
_CODES = {
    "i8": "b", "u8": "B", "i16": "h", "u16": "H", "i32": "i", "u32": "I", "i64": "q", "u64": "Q",
    "f32": "f",
}  # fmt: skip
# firmware value: (unit, step) as in docs/virtual-drive.md
_FIRMWARE: dict[str, tuple[Unit, float]] = {
    "controlword": (Unit.NONE, 1.0), "statusword": (Unit.NONE, 1.0), "error_code": (Unit.NONE, 1.0),
    "mode": (Unit.NONE, 1.0), "mode_display": (Unit.NONE, 1.0), "supported_modes": (Unit.NONE, 1.0),
    "torque_target": (Unit.RATED_TORQUE, 1e-3), "torque_actual": (Unit.RATED_TORQUE, 1e-3),
    "position_target": (Unit.INCREMENT, 1.0), "position_actual": (Unit.INCREMENT, 1.0),
    "velocity_actual": (Unit.INCREMENT_PER_SECOND, 1.0), "rated_torque": (Unit.TORQUE, 1e-6),
    "encoder_increments": (Unit.NONE, 1.0), "encoder_revolutions": (Unit.NONE, 1.0),
    "max_torque": (Unit.RATED_TORQUE, 1e-3), "max_speed": (Unit.RPM, 0.1),
    "torque_slope": (Unit.RATED_TORQUE_PER_SECOND, 1e-3), "quick_stop_option": (Unit.NONE, 1.0),
    "abort_connection_option": (Unit.NONE, 1.0), "torque_offset": (Unit.RATED_TORQUE, 1e-3),
    "coulomb_positive": (Unit.RATED_TORQUE, 1e-3), "coulomb_negative": (Unit.RATED_TORQUE, 1e-3),
    "viscous_gain": (Unit.RATED_TORQUE_PER_SPEED, 1e-5), "coulomb_speed": (Unit.RPM, 0.1),
    "velocity_gain": (Unit.RATED_TORQUE_PER_SPEED, 1e-6), "integral_time": (Unit.SECOND, 1e-6),
    "position_gain": (Unit.PER_SECOND, 0.01), "watchdog_time": (Unit.SECOND, 1e-3),
    "serial": (Unit.NONE, 1.0), "store_command": (Unit.NONE, 1.0),
}  # fmt: skip
# a profile's own name for it, where it is another one
_NAMES = {"mode_of_operation": "mode", "serial_number": "serial"}
# CiA 402's, which only a habit makes
_OPTIONAL = {0x6073, 0x607B, 0x607E, 0x6091, 0x6092, 0x6093, 0x60C2, 0x100C, 0x100D}
_RATIOS = (  # what a drive counts in is as without them
    "feed_revolutions", "gear_motor_revolutions", "gear_shaft_revolutions", "position_factor",
    "position_divisor",
)  # fmt: skip
_ELSEWHERE = {0x1010, 0x1016, 0x1018}  # communication objects, which the node itself has
_SIMULATION = {"simulation_cycle", "simulation_advance"}
_MARK = 0x7457
_CLOCK = {
    CLOCK: Entry(("simulation_cycle",), "I"),
    CLOCK + 2: Entry(("simulation_advance",), "I"),
    CLOCK + 4: Entry((), "H", "ro", default=_MARK, name="mark of a twin"),
}
# the modes of CiA 402 that the firmware knows; the first is what another code means
_STANDARD = {
    Mode.TORQUE: (MODE_CYCLIC_TORQUE, MODE_PROFILE_TORQUE), Mode.POSITION: (MODE_CYCLIC_POSITION,),
}  # fmt: skip
RATED_CURRENT = 2.0  # A, of every virtual motor


def twin(profile: Profile, axis: VirtualAxis, *, complete: bool = False) -> Dictionary:
    """The object dictionary of the drive that `profile` is for, before `axis`.

    `complete` : with what not every drive has, saying nothing else than without. Raises UsageError.
    """
    if profile.bus != "canopen":
        raise UsageError(
            f"profile '{profile.name}' is for {profile.bus}: its twin is no CANopen node"
        )
    objects: dict[tuple[int, int], Entry] = dict(SIMULATION)
    behind = _behind(profile)
    indices = set()
    for name, parameter in profile.parameters.items():
        address = parameter.address
        assert isinstance(address, CanopenAddress)
        indices.add(address.index)
        keys = behind.get(name) or (_NAMES.get(name, name),)
        is_optional = address.index in _OPTIONAL and keys[0] not in _FIRMWARE
        if address.index in _ELSEWHERE or (is_optional and not complete):
            continue
        entry = _entry(name, keys, profile, axis)
        if is_optional:
            entry = entry._replace(default=_neutral(address, axis))
        objects[address.index, address.sub] = entry
    identity = tuple(_number(text) for text in (profile.identity.vendor, profile.identity.product))
    revision = profile.identity.revisions[0] if profile.identity.revisions else "0x00010000"
    return Dictionary(
        objects,
        (identity[0], identity[1], _number(revision)),
        {0x1008: f"twin of {profile.name}".encode(), 0x1009: b"none", 0x100A: b"1.0"},
        frozenset({0x1010, 0x1016} - indices),
    )


def _neutral(address: CanopenAddress, axis: VirtualAxis) -> int:
    """What an object says that not every drive has, and that changes nothing."""
    least, most = address.raw_range
    values = {
        (0x6092, 1): round(_TURN / axis.resolution), (0x607B, 1): least, (0x607B, 2): most,
        (0x6073, 0): round(1000 * axis.peak / axis.rated), (0x607E, 0): 0,
        (0x60C2, 2): -3, (0x100C, 0): 0, (0x100D, 0): 0,
    }  # fmt: skip
    return values.get((address.index, address.sub), 1)


def habits_of_twin(profile: Profile, habits: Habits) -> Habits:
    """What the drive of a profile does beside what its objects say."""
    guards = {"guarding": ""} if profile.watchdog.kind == "guarding" else {}
    return Habits(guards | habits.values)


def within(profile: Profile, firmware: Firmware) -> None:
    """The drive as delivered has no setting that its profile does not allow."""
    for name, parameter in profile.parameters.items():
        key = (_behind(profile).get(name) or (_NAMES.get(name, name),))[0]
        if key not in _FIRMWARE or parameter.protection is not Protection.EXPERIMENT:
            continue
        unit, step = _FIRMWARE[key]
        factor = parameter.scale * _size(parameter.unit, firmware.axis)
        most = parameter.range[1] * factor / (step * _size(unit, firmware.axis))
        firmware.values[key] = min(firmware.values[key], max(round(most), 0))


def modbus_twin(
    profile: Profile,
    device: Device,
    habits: Habits = NONE,
    around: Callable[[Mirror], Mirror] = lambda mirror: mirror,
) -> RegisterMap:
    """The registers of the drive that `profile` is for, in front of `device`; raises UsageError.

    `around` : what stands between the registers and their values
    """
    if profile.bus != "modbus":
        raise UsageError(
            f"profile '{profile.name}' is for {profile.bus}: its twin has no registers"
        )
    axis = device.firmware.axis
    if profile.watchdog.kind == "none":
        device.firmware.values["watchdog_time"] = 0
    switchgear = None
    if profile.power is not None:
        switchgear = Switchgear(device, profile, profile.power)
    behind = _behind(profile)
    registers = dict(_CLOCK)
    bits: dict[int, tuple[tuple[Entry, int], ...]] = {}
    low_first: set[int] = set()
    posted: dict[tuple[int, int], Entry] = {}
    plain: list[ModbusAddress] = []
    for name, parameter in profile.parameters.items():
        at = parameter.address
        keys = behind.get(name) or (_NAMES.get(name, name),)
        entry = _entry(name, keys, profile, axis)
        if isinstance(at, MailboxAddress):
            posted[at.pnu, at.sub] = entry
            continue
        at = _modbus(parameter)
        plain.append(at)
        if name == "product_code":
            entry = Entry((), entry.code, "ro", 1.0, _number(profile.identity.product), name)
        if at.bits is not None:
            bits[at.register_] = (*bits.get(at.register_, ()), (entry, at.bits))
            continue
        registers.setdefault(at.register_, entry)
        if at.word_order == "low-first":
            low_first.add(at.register_)
    who = profile.identity
    name = f"twin of {profile.name}"
    layout = Layout(
        registers,
        _modbus(profile.parameters["position_actual"]).register_ if profile.moves else -1,
        bits,
        frozenset(low_first),
        _between(profile),
        _functions(profile, plain),
        (
            who.vendor or "tworelay",
            who.product or name,
            who.revisions[0] if who.revisions else name,
        ),
        profile.watchdog.kind == "traffic",
        profile.mailbox,
        posted,
    )
    keeps = profile.store is not None and not profile.store.steps
    return RegisterMap(
        device, bent(layout, habits), switchgear, keeps=keeps, habits=habits, around=around
    )


def _functions(profile: Profile, addresses: list[ModbusAddress]) -> frozenset[int]:
    """Modbus functions that the drive knows."""
    found = {3, 6, 16} | {at.write_function for at in addresses}
    found |= {at.read_function for at in addresses}
    found |= {23} if profile.cycle.function == "fc23" else set()
    return frozenset(found | ({43} if profile.identity.asked else set()))


def _modbus(parameter: Parameter) -> ModbusAddress:
    assert isinstance(parameter.address, ModbusAddress)
    return parameter.address


def _between(profile: Profile) -> frozenset[int]:
    """Registers that are read along with the cycle."""
    taken = [_modbus(profile.parameters[name]) for name in profile.cycle.in_]
    return frozenset(
        register
        for before, after in pairwise(taken)
        if 0 <= after.register_ - before.register_ - before.count <= profile.cycle.gap
        for register in range(before.register_ + before.count, after.register_)
    )


def _behind(profile: Profile) -> dict[str, tuple[str, ...]]:
    """Firmware values behind parameters of compensation, limits and watchdog."""
    found = {
        name: (f"max_{kind}",)
        for kind, name in profile.limits.items()
        if kind in ("torque", "speed")
    }
    if profile.watchdog.parameter is not None:
        found[profile.watchdog.parameter] = ("watchdog_time",)
    stored = [step.write for step in (profile.store.steps if profile.store else ()) if step.write]
    if stored:  # by procedure the switchgear does it
        found[stored[-1]] = ("store_command",) if profile.power is None else ("",)
    return found | _compensation(profile)


def _compensation(profile: Profile) -> dict[str, tuple[str, ...]]:
    law = profile.compensation
    both = ("coulomb_positive", "coulomb_negative")
    named = {
        law.offset: ("torque_offset",), law.positive: both[:1], law.negative: both[1:],
        law.gain: both, law.speed: ("coulomb_speed",), law.viscous: ("viscous_gain",),
        law.static: both, law.dynamic: ("viscous_gain",),
    }  # fmt: skip
    if not law.terms:
        return {}
    found = {name: keys for name, keys in named.items() if name is not None}
    if law.table:
        found |= {law.table[0].torque: both, law.table[0].speed: ("coulomb_speed",)}
    return found


def _entry(
    name: str,
    keys: tuple[str, ...],
    profile: Profile,
    axis: VirtualAxis,
) -> Entry:
    parameter = profile.parameters[name]
    access = str(parameter.access)
    code = _CODES[parameter.address.type]
    fixed = _fixed(name, profile, axis)
    if fixed is not None:
        return Entry((), code, "ro", name=name, default=fixed)
    if name in _SIMULATION:
        return Entry((name,), code, access, name=name)
    known = [key for key in keys if key in _FIRMWARE]
    if not known:
        return Entry((), code, access, name=name, default=_delivered(name, profile, axis))
    unit, step = _FIRMWARE[known[0]]
    law = profile.compensation
    sign = law.negative_sign if name == law.negative else 1
    factor = sign * parameter.scale * _size(parameter.unit, axis) / (step * _size(unit, axis))
    return Entry(tuple(known), code, access, factor, name=name, codes=_codes(known[0], profile))


def _fixed(name: str, profile: Profile, axis: VirtualAxis) -> float | None:
    """What an object says for good; None: it is none of these."""
    parameter = profile.parameters[name]
    if name == "supported_modes":
        return _supported(profile)
    if name == "rated_current":
        return _shown(axis.rated, parameter, axis)
    if name == "feed_units" or name in _RATIOS:
        return round(_TURN / axis.resolution) if name == "feed_units" else 1
    required = [v for c in profile.requires if c.parameter == name for v in c.wanted]
    if name == profile.own_estimates.get("coulomb"):
        return required[0] if required else _shown(axis.coulomb, parameter, axis)
    if name == profile.conditions.get("motor_temperature"):
        return required[0] if required else _shown(axis.temperature, parameter, axis)
    return None


def _delivered(name: str, profile: Profile, axis: VirtualAxis) -> int:
    """What an object that the firmware does not know reads before anybody has written to it.

    What the profile requires of it; a limit's most; else what no step has to write.
    """
    parameter = profile.parameters[name]
    for condition in profile.requires:
        if condition.parameter == name and condition.wanted:
            return condition.wanted[0]
    most = {"torque_negative": axis.peak, "speed_negative": axis.speed}
    for kind, value in most.items():
        if profile.limits.get(kind) == name:  # type: ignore[call-overload]
            raw = round(value / (parameter.scale * _size(parameter.unit, axis)))
            return -raw if parameter.range[1] <= 0 else raw
    before = [step for codes in profile.modes.values() for code in codes for step in code.before]
    watchdog = profile.watchdog
    written = {step.raw for step in before if step.write == name}
    written |= {watchdog.reaction_raw} if watchdog.reaction == name else set()
    lock = profile.exclusive
    written |= {lock.raw} if lock is not None and lock.write == name else set()
    enabling = {s.raw for s in profile.power.enable if s.write == name} if profile.power else set()
    taken = enabling or written  # a register that enables rests at 0
    first = max(0, int(parameter.range[0])) if not parameter.is_float else 0
    tried = range(first, first + len(taken) + len(parameter.forbidden) + 1)
    free = (raw for raw in tried if parameter.allows(raw))
    return next((raw for raw in free if raw not in taken), 0)


def _shown(value: float, parameter: Parameter, axis: VirtualAxis) -> float:
    """A value of the motor, SI, as a parameter counts it."""
    raw = value / (parameter.scale * _size(parameter.unit, axis))
    return raw if parameter.is_float else round(raw)


def _supported(profile: Profile) -> int:
    """Supported modes as 6502h has them, and those that the profile knows by bits of its own."""
    bits = {code.supported_bit for codes in profile.modes.values() for code in codes} - {None}
    return sum(1 << bit for bit in bits | {mode - 1 for mode in MODES} if bit is not None)


def _codes(key: str, profile: Profile) -> tuple[tuple[int, int], ...]:
    """Modes as the profile counts them, where it is not as CiA 402 does; its word for a store."""
    if key == "store_command" and profile.store is not None:
        return tuple((step.raw, 1) for step in profile.store.steps if step.raw is not None)
    if key not in ("mode", "mode_display"):
        return ()
    return tuple(
        (code.code, _STANDARD[mode][0])
        for mode, codes in profile.modes.items()
        for code in codes
        if code.code is not None and code.code not in _STANDARD[mode]
    )


def _size(unit: Unit, axis: VirtualAxis) -> float:
    """What one of a unit is, in SI of the motor."""
    constant = axis.rated / RATED_CURRENT
    increment = axis.resolution
    return {
        Unit.RATED_TORQUE: axis.rated, Unit.RATED_TORQUE_PER_SECOND: axis.rated,
        Unit.RATED_TORQUE_PER_SPEED: axis.rated, Unit.CURRENT: constant, Unit.RPM: _TURN / 60,
        Unit.REVOLUTION: _TURN, Unit.INCREMENT: increment, Unit.INCREMENT_PER_SECOND: increment,
    }.get(unit, 1.0)  # fmt: skip


def _number(text: str | None) -> int:
    try:
        return int(text or "0", 0)
    except ValueError:
        return 0
