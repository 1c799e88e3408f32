"""Which parameters of a drive command it: its power, its mode, its set-points."""

from __future__ import annotations

from profiles.schema import CanopenAddress, Mode, Profile, Step

__all__ = ["commands", "enabling", "position_set_points", "set_points"]

# CiA 402, of each axis of a drive
_CONTROLWORD, _MODE, _TARGET_POSITION = 0x6040, 0x6060, 0x607A
_TARGETS = {0x6042, 0x6071, _TARGET_POSITION, 0x60FF}  # velocity (vl), torque, position, velocity
_FIRST, _END, _AN_AXIS = 0x6000, 0xA000, 0x800
_WAY_UP = (0x06, 0x07, 0x0F)  # shutdown, switch on, enable operation


def set_points(profile: Profile) -> frozenset[str]:
    """Names of the parameters that say how fast, how far, or how hard the axis is driven."""
    named = {code.set_point for codes in profile.modes.values() for code in codes}
    return frozenset(named | _at(profile, _TARGETS))


def position_set_points(profile: Profile) -> frozenset[str]:
    """Those of them that are positions."""
    named = {code.set_point for code in profile.modes.get(Mode.POSITION, ())}
    return frozenset(named | _at(profile, {_TARGET_POSITION}))


def commands(profile: Profile) -> frozenset[str]:
    """Names of the set-points, and of the parameters by which mode and power are chosen."""
    power = profile.power
    steps = [*profile.stop, *profile.disable]
    steps += [*power.enable, *power.reset] if power is not None else []
    steps += [step for codes in profile.modes.values() for code in codes for step in code.before]
    written = {step.write for step in steps if step.write is not None}
    words = {"controlword", "mode_of_operation"} & profile.parameters.keys()
    found = set_points(profile) | written | words | _at(profile, {_CONTROLWORD, _MODE})
    return frozenset(found)


def enabling(profile: Profile) -> frozenset[tuple[str, int]]:
    """Parameters with the raw values by which the profile enables the drive, and nothing else it does."""
    found = {
        (name, word)
        for name in {"controlword"} & profile.parameters.keys() | _at(profile, {_CONTROLWORD})
        for word in _WAY_UP
    }
    power = profile.power
    found |= _writes(power.enable) if power is not None else set()
    before = [step for codes in profile.modes.values() for code in codes for step in code.before]
    without = _writes((*before, *profile.disable))
    return frozenset(found - without)


def _writes(steps: tuple[Step, ...]) -> set[tuple[str, int]]:
    return {(s.write, s.raw) for s in steps if s.write is not None and s.raw is not None}


def _at(profile: Profile, indices: set[int]) -> set[str]:
    """Names of the parameters at these objects of CiA 402, of whichever axis."""
    return {
        name
        for name, parameter in profile.parameters.items()
        if isinstance(parameter.address, CanopenAddress)
        and _FIRST <= (index := parameter.address.index) < _END
        and _FIRST + (index - _FIRST) % _AN_AXIS in indices
    }
