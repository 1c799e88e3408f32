"""Power by procedure.

Which writes energise the firmware of a twin, and what it says of its state.
"""

from __future__ import annotations

from drivers.virtual.device import Device
from drivers.virtual.objects import MODE_CYCLIC_POSITION, MODE_CYCLIC_TORQUE
from drivers.virtual.states import State
from profiles.procedures import Condition, Mode, Power, writes_of
from profiles.schema import Profile

__all__ = ["Switchgear"]

_REMEMBERED = 16  # values of a register: the longest sequence of keys that enables
_SHUTDOWN, _SWITCH_ON, _ENABLE, _QUICK_STOP, _OFF, _RESET = 0x06, 0x07, 0x0F, 0x02, 0x00, 0x80

Write = tuple[str, int]


class Switchgear:
    """The steps of a profile's power, stop, disable and store, done to a device."""

    def __init__(self, device: Device, profile: Profile, power: Power) -> None:
        self._device = device
        self._power = power
        self._recent: dict[str, list[int]] = {}  # raw values, the latest last
        self._enable = writes_of(power.enable)
        self._reset = writes_of(power.reset)
        self._stop = [step for step in writes_of(profile.stop) if step[0] != "torque_target"]
        self._disable = writes_of(profile.disable)
        self._store = writes_of(profile.store.steps) if profile.store else []
        self._ready = {
            step.until: step.equals or 0
            for step in (profile.store.steps if profile.store else ())
            if step.until is not None
        }
        others = (*power.enable, *power.reset, *profile.stop, *profile.disable)
        # it is as soon as it was told
        self._at_once = {step.until: step.equals or 0 for step in others if step.until is not None}
        switched = {name for name, _ in self._enable} | {"torque_target"}
        before = writes_of(profile.modes[Mode.TORQUE][0].before) if profile.moves else []
        self._torque = [write for write in before if write[0] not in switched]
        self._is_told_its_mode = "mode_of_operation" in profile.parameters

    def written(self, name: str, raw: int) -> None:
        """An object was written; raises Denied."""
        held = self._hold(self._enable)
        self._recent[name] = [*self._recent.get(name, [0]), raw][-_REMEMBERED:]
        write = (name, raw)
        if write in self._disable:
            self._control(_OFF)
        elif write in self._stop:
            self._control(_QUICK_STOP)
        elif write in self._reset:
            self._control(_RESET, _OFF)
        elif self._enable and self._hold(self._enable) and (not held or write == self._enable[-1]):
            if not self._is_told_its_mode:
                torque = self._hold(self._torque)
                self._device.firmware.write(
                    "mode", MODE_CYCLIC_TORQUE if torque else MODE_CYCLIC_POSITION
                )
            self._control(_SHUTDOWN, _SWITCH_ON, _ENABLE)
        elif self._store and write == self._store[-1]:
            self._device.write("store_command", 1)

    def says(self, name: str) -> int | None:
        """What an object reads that tells the state; None: it tells none."""
        firmware = self._device.firmware
        if name in self._ready:
            busy = self._device.read("store_status") != 0
            return self._ready[name] ^ 1 if busy else self._ready[name]
        tripped = firmware.state in (State.FAULT, State.FAULT_REACTION_ACTIVE)
        enabled = firmware.state is State.OPERATION_ENABLED
        brakes, stopping, fault = (
            firmware.energised and not enabled,
            self._power.stopping,
            self._power.fault,
        )
        if stopping is not None and fault is not None and stopping.mask & fault.mask:
            tripped = tripped and not brakes  # one value at a time: first that it brakes, then why
        conditions = (
            (self._power.enabled, enabled),
            (stopping, brakes),
            (fault, tripped),
        )
        there = [
            (condition, holds)
            for condition, holds in conditions
            if condition is not None and condition.parameter == name
        ]
        if not there:
            return self._at_once.get(name)
        return _word(there, moves=firmware.velocity != 0)

    def _hold(self, writes: list[Write]) -> bool:
        """Whether each register has had its values last, in their order."""
        wanted: dict[str, list[int]] = {}
        for name, raw in writes:
            wanted.setdefault(name, []).append(raw)
        return all(
            self._recent.get(name, [0])[-len(raws) :] == raws for name, raws in wanted.items()
        )

    def _control(self, *words: int) -> None:
        for word in words:
            self._device.firmware.write("controlword", word)


def _word(conditions: list[tuple[Condition, bool]], *, moves: bool) -> int:
    """A raw value with which each condition holds, or does not.

    Of several values that say the same, the last one says that the axis moves.
    """
    found = [0]
    for condition, holds in conditions:
        found = [word | bits for bits in _bits(condition, holds=holds, moves=moves)
                 for word in found]  # fmt: skip
    return next(
        (word for word in found if all(c.holds(word) is holds for c, holds in conditions)), found[0]
    )


def _bits(condition: Condition, *, holds: bool, moves: bool) -> list[int]:
    """Raw values with which one condition holds, or does not; the plainest first."""
    every = condition.mask & (0xFFFF if condition.mask < 0 else 0xFFFFFFFF)
    least = every & -every
    if condition.differs is None:
        wanted = condition.wanted
        if holds:
            return list(reversed(wanted)) if moves else list(wanted)
        return [0, every, *(value ^ least for value in wanted)]
    return [condition.differs ^ least, every] if holds else [condition.differs]
