"""What a virtual drive says and takes, bent by the habits that need no bus to show."""

from __future__ import annotations

from drivers.virtual.device import Device
from drivers.virtual.firmware import SECOND
from drivers.virtual.habits import Habits
from drivers.virtual.mirror import Entry, Mirror
from drivers.virtual.states import DenialReason, Denied, State
from drivers.virtual.switchgear import Switchgear

__all__ = ["HabitualMirror", "mirror_of"]

_FAULT, _RESET, _HALT, _ENABLE = 0x0208, 0x80, 0x0100, 0x0F  # statusword; bits of the controlword
_LIMIT = 0x0800  # statusword: internal limit active
_HOLDS = 6  # 605Ah: slow down on the quick stop ramp and stay there
_COUNTED = {"position_actual", "position_target", "velocity_actual", "velocity_target"}


def mirror_of(
    device: Device,
    habits: Habits,
    switchgear: Switchgear | None = None,
    *,
    keeps: bool = False,
) -> Mirror:
    """The mirror of a device with these habits."""
    if habits.values:
        return HabitualMirror(device, habits, switchgear, keeps=keeps)
    return Mirror(device, switchgear, keeps=keeps)


class HabitualMirror(Mirror):
    """What objects say, bent by habits; what the drive does is the virtual drive's."""

    def __init__(
        self,
        device: Device,
        habits: Habits,
        switchgear: Switchgear | None = None,
        *,
        keeps: bool = False,
    ) -> None:
        super().__init__(device, switchgear, keeps=keeps)
        self._habits = habits
        self._firmware = device.firmware
        increments = self._firmware.read("encoder_increments")
        self._units = (habits.units or increments) / increments  # a count
        if "polarity" in habits:
            self._units = -self._units
        self._range = -(1 << 31), 1 << 32  # least, and how many
        if "modulo" in habits:
            self._range = 0, habits.number("modulo")
        self._began = (1 << 31) - habits.number("wrap") if "wrap" in habits else 0
        self._fault_until = self._mode_until = 0  # ns
        self._mode_before = 0
        self._enabled_at: int | None = None  # ns; None: nobody has asked for it
        self._enabling = Entry((), "H"), 0  # the controlword that asked
        self._halted = "halt" in habits
        self._limit: int | None = None  # torque limit as it is told; None: as it is
        self._current = habits.number("low-current") or self._most_torque()
        if "zero-limit" in habits:
            self._limit = 0
        if "low-current" in habits:
            self._limit = self._firmware.read("max_torque")
            self._limit_torque()
        if "quick-stop-stays" in habits:
            self._firmware.values["quick_stop_option"] = _HOLDS

    def value(self, entry: Entry) -> float:
        """Object value, in the object's own steps; raises Denied."""
        keys, now = entry.keys, self._firmware.now
        if self._enabled_at is not None and now >= self._enabled_at:
            self._set_controlword(*self._enabling)
        shown = super().value(entry)
        if _COUNTED & set(keys):
            return self._counted(round(shown * self._units), entry)
        if "statusword" in keys:
            word = _FAULT if now < self._fault_until else int(shown)
            shown = word | (_LIMIT if "limit-bit" in self._habits else 0)
        elif "mode_display" in keys and now < self._mode_until:
            shown = self._mode_before
        elif "torque_actual" in keys and "unsigned-torque" in self._habits:
            shown = abs(shown)
        elif "max_torque" in keys and self._limit is not None:
            shown = self._limit
        return shown

    def set(self, entry: Entry, value: float) -> None:
        """Write an object value to all that it mirrors; raises Denied."""
        keys = entry.keys
        if "mode" in keys:
            self._set_mode(entry, value)
        elif "controlword" in keys:
            self._set_controlword(entry, int(value))
        elif "max_torque" in keys and self._limit is not None:
            super().set(entry, value)
            self._limit = int(value)
            self._limit_torque()
        elif entry.name == "max_current" and not keys:
            super().set(entry, value)
            self._current = int(value)
            self._limit_torque()
        elif _COUNTED & set(keys):
            super().set(entry, round(self._meant(int(value), entry) / self._units))
        else:
            super().set(entry, value)

    def _most_torque(self) -> int:
        axis = self._firmware.axis
        return round(1000 * axis.peak / axis.rated)

    def _limit_torque(self) -> None:
        """What acts: the smaller of both limits, of which 0 limits nothing."""
        most = self._most_torque()
        limit = min(round(self._limit or most), self._current, most)
        self._firmware.values["max_torque"] = limit

    def _set_mode(self, entry: Entry, value: float) -> None:
        before = self._firmware.read("mode_display")
        if self._halted or ("same-mode" in self._habits and value == before):
            raise Denied(DenialReason.STATE)
        super().set(entry, value)
        if value != before:
            self._mode_before = before
            self._mode_until = self._firmware.now + self._time("slow-mode")

    def _set_controlword(self, entry: Entry, word: int) -> None:
        now, is_off = self._firmware.now, self._firmware.state is State.SWITCHED_ON
        self._halted = self._halted and bool(word & _HALT)
        if is_off and word & _ENABLE == _ENABLE and not self._firmware.energised:
            if self._enabled_at is None:
                self._enabled_at = now + self._time("slow-enable")
                self._enabling = entry, word
            if now < self._enabled_at:
                return
        self._enabled_at = None
        super().set(entry, word)
        if word & _RESET:
            self._fault_until = now + self._time("slow-reset")

    def _time(self, name: str) -> int:
        return round(self._habits.seconds(name) * SECOND)

    def _counted(self, count: int, entry: Entry) -> int:
        """A position as its counter shows it, from where it stood."""
        if "velocity_actual" in entry.keys or "velocity_target" in entry.keys:
            return count
        low, width = self._range
        return (count + self._began - low) % width + low

    def _meant(self, shown: int, entry: Entry) -> int:
        """The position nearest to the axis' own that a counter shows as `shown`."""
        if "position_target" not in entry.keys:
            return shown
        here = round(self._firmware.read("position_actual") * self._units)
        width = self._range[1]
        turned = (shown - self._began - here + width // 2) % width - width // 2
        return here + turned
