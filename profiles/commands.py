"""Which parameters of a drive command it: its power, its mode, its set-points.

And what may be put back.
"""

from __future__ import annotations

from dataclasses import dataclass

from profiles.address import CanopenAddress
from profiles.parameter import Protection
from profiles.procedures import Mode, writes_of
from profiles.schema import Profile

__all__ = ["SET", "Commands", "commands_of"]

SET = frozenset({"mode_of_operation", "torque_target", "position_target"})  # by each job

# CiA 402, of each axis of a drive
_CONTROLWORD, _MODE, _TARGET_POSITION = 0x6040, 0x6060, 0x607A
_TARGETS = {0x6042, 0x6071, 0x60FF}  # velocity (vl), torque, velocity
_FIRST, _END, _AN_AXIS = 0x6000, 0xA000, 0x800
_ENABLE_VOLTAGE = 0x02  # of a controlword: without it the drive is without energy
_SETTINGS = (Protection.EXPERIMENT, Protection.COMPENSATION, Protection.GAIN)


@dataclass(frozen=True, slots=True)
class Commands:
    """What commands a drive, by the names of its profile's parameters.

    Attributes
    ----------
    names : all of it
    set_points : how fast, how far, or how hard the axis is driven
    positions : those of them that are positions of this axis
    restorable : whatever may be written back at all, settings included
    controlwords : controlwords of CiA 402
    by_procedure : parameters and raw values by which the profile enables the drive, and nothing
        else it does
    """

    names: frozenset[str]
    set_points: frozenset[str]
    positions: frozenset[str]
    restorable: frozenset[str]
    controlwords: frozenset[str]
    by_procedure: frozenset[tuple[str, int]]

    def enables(self, name: str, raw: int) -> bool:
        """Whether a raw value may give energy to the drive, or leave it there."""
        if name in self.controlwords:
            return bool(raw & _ENABLE_VOLTAGE)
        return (name, raw) in self.by_procedure


def commands_of(profile: Profile) -> Commands:
    """What commands the drive of a profile."""
    power = profile.power
    before = [step for codes in profile.modes.values() for code in codes for step in code.before]
    switching = [*profile.stop, *profile.disable]
    switching += [*power.enable, *power.reset] if power is not None else []
    enabling = set(writes_of(power.enable)) if power is not None else set()
    switches = {step.write for step in switching if step.write is not None}
    words = _named(profile, {"controlword"}) | _at(profile, {_CONTROLWORD})
    modes = _named(profile, {"mode_of_operation"}) | _at(profile, {_MODE})
    positions = {code.set_point for code in profile.modes.get(Mode.POSITION, ())}
    positions |= _named(profile, {"position_target"}) | _at(profile, {_TARGET_POSITION}, own=True)
    targets = {code.set_point for codes in profile.modes.values() for code in codes}
    targets |= _named(profile, {"torque_target"}) | _at(profile, _TARGETS) | positions
    others = _at(profile, {_TARGET_POSITION}) - positions  # of other axes
    written = {step.write for step in before if step.write is not None}
    kept = SET | (switches if power is not None else set())
    return Commands(
        names=frozenset(targets | others | words | modes | switches | written),
        set_points=frozenset(targets),
        positions=frozenset(positions),
        restorable=frozenset(
            name
            for name, parameter in profile.parameters.items()
            if parameter.protection in _SETTINGS
            or (parameter.protection is Protection.COMMAND and name in kept)
        ),
        controlwords=frozenset(words),
        by_procedure=frozenset(enabling - set(writes_of((*before, *profile.disable)))),
    )


def _named(profile: Profile, names: set[str]) -> set[str]:
    return names & profile.parameters.keys()


def _at(profile: Profile, indices: set[int], *, own: bool = False) -> set[str]:
    """Names of the parameters at these objects of CiA 402, of each axis or of the `own`."""
    word = profile.parameters.get("controlword")
    axis = getattr(word.address, "index", _CONTROLWORD) - _CONTROLWORD if word is not None else 0
    found = set()
    for name, parameter in profile.parameters.items():
        index = parameter.address.index if isinstance(parameter.address, CanopenAddress) else 0
        here = index - axis if own else _FIRST + (index - _FIRST) % _AN_AXIS
        if _FIRST <= index < _END and here in indices:
            found.add(name)
    return found
