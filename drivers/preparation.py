"""What a job will change in a drive, and put back.

Read and worked out before anything is written.
"""

from __future__ import annotations

from drivers import cia402
from drivers.access import RawAccess
from drivers.bases import interpolation_period
from drivers.bus import GUARDS, SET
from drivers.described import Parameters
from drivers.errors import AccessDenied, PreflightRefused
from drivers.modes import Modes, SetPoint
from profiles.parameter import Access, Protection
from profiles.procedures import Mode, Step

__all__ = ["Preparation"]

_WORD_BITS = 16
_WORD = 1 << _WORD_BITS


class Preparation:
    """What a job needs of one drive; every dict is of raw values by parameter name.

    Attributes
    ----------
    dispensable : parameters that are set where the drive takes them
    """

    dispensable = frozenset({"interpolation_time", "interpolation_exponent", "quick_stop_option"})

    def __init__(self, access: RawAccess, modes: Modes, parameters: Parameters) -> None:
        self._access = access
        self._profile = access.profile
        self._modes = modes
        self._parameters = parameters

    # -- before anything is written --------------------------------------------------------------

    def check_requirements(self) -> None:
        """Read what the profile requires of a drive that is to move; raises PreflightRefused."""
        self.check_conditions()
        self._check_enabling_value()

    def check_conditions(self) -> None:
        """What it requires of a drive that is written to, too; raises PreflightRefused."""
        self.check_word_order()
        for condition in self._profile.requires:
            there = self._access.read(condition.parameter)
            if not condition.holds(there):
                parameter = self._access.parameter(condition.parameter)
                raise PreflightRefused(
                    f"'{condition.parameter}' ({parameter.address}, {parameter.title}) reads "
                    f"{there}, and {condition}: set it in the drive first",
                    code="preflight.requires",
                )

    def check_word_order(self) -> None:
        """Refuse a drive that swaps the words of its values for this computer."""
        names = self._profile.link.swapped_for
        own = self._access.bus.own_address() if names else ""
        if not own:
            return
        # it may have swapped these already
        told = [there if there < _WORD else there >> _WORD_BITS for there in
                (self._access.read(name) for name in names)]  # fmt: skip
        if ".".join(map(str, told)) == own:
            at = self._access.parameter(names[0]).address
            raise PreflightRefused(
                f"the drive swaps the words of its values for the master at {own}, which is this "
                f"computer ({at} and the next ones)",
                code="preflight.word-order",
                hint="set another address there, or speak from another one",
            )

    def _check_enabling_value(self) -> None:
        """Refuse a drive whose enabling register holds the enabling value: it would be put back."""
        power = self._profile.power
        prepared = self.settings(Mode.TORQUE)
        for step in power.enable if power is not None else ():
            if step.write not in prepared or step.raw in (None, prepared[step.write]):
                continue
            if self._access.read(step.write) == step.raw:
                raise PreflightRefused(
                    f"'{step.write}' ({self._access.parameter(step.write).address}) reads "
                    f"{step.raw}, which enables the drive: what uses it? Set it to another value "
                    "first",
                    code="preflight.enabling-value",
                )

    def check_set_points(self, mode: Mode, largest: float) -> None:
        """Raises PreflightRefused where ±`largest` (SI) does not fit the set-point of `mode`."""
        code = self._modes.supported(mode)
        set_point = SetPoint(mode, code, self._parameters, self._access)
        for value in (-largest, largest):
            set_point.check(round(value / set_point.step))

    # -- what will be written --------------------------------------------------------------------

    def settings(self, mode: Mode) -> dict[str, int]:
        """What `mode` needs set before it is enabled."""
        steps = self._modes.supported(mode).before
        found = self.exclusive_access() | self._standard()
        found |= {s.write: s.raw for s in steps if s.write is not None and s.raw is not None}
        host = self._profile.compensation.host
        if host is not None and self._is_set(host):
            found[host] = 0  # it would act on top of every command
        return found

    def _standard(self) -> dict[str, int]:
        """What CiA 402 asks of any mode.

        The period of the set-points, and a quick stop that ends.
        """
        found: dict[str, int] = {}
        value = self._access.optional("interpolation_time")
        power = self._access.optional("interpolation_exponent")
        if value is not None and power is not None:
            cycle = self._access.bus.cycle
            told, exponent = interpolation_period(cycle)
            found = {"interpolation_time": told, "interpolation_exponent": exponent}
            if self._parameters["interpolation_exponent"].protection is Protection.READ:
                found = {"interpolation_time": round(cycle / 10.0**power)}  # it counts so, for good
        option = self._access.optional("quick_stop_option")
        if option is not None and option >= cia402.STAYS_IN_QUICK_STOP:
            found["quick_stop_option"] = cia402.QUICK_STOP_RAMP
        return found

    def _is_set(self, name: str) -> bool:
        """Whether an object that not every drive has is there, and not zero."""
        try:
            return self._access.read(name) != 0
        except AccessDenied:
            return False

    def exclusive_access(self) -> dict[str, int]:
        """What locks other masters out, where the drive has it."""
        lock = self._profile.exclusive
        return {lock.write: lock.raw} if lock and lock.write and lock.raw is not None else {}

    def watchdog(self) -> dict[str, int]:
        """What arms the drive-side watchdog; empty: it has none."""
        watchdog = self._profile.watchdog
        if watchdog.parameter is None or watchdog.kind == "none":
            return {}
        raw = self._parameters[watchdog.parameter].raw(watchdog.timeout)
        if watchdog.kind == "heartbeat":
            raw |= watchdog.node << 16  # CiA 301, object 1016h: node in bits 16-23
        settings = {watchdog.parameter: raw}
        if watchdog.kind == "guarding" and watchdog.life_factor is not None:
            settings = {watchdog.parameter: max(1, raw // GUARDS), watchdog.life_factor: GUARDS}
        if watchdog.reaction is not None and watchdog.reaction_raw is not None:
            settings[watchdog.reaction] = watchdog.reaction_raw
        return settings

    def code_of(self, mode: Mode) -> int | None:
        """Value of `mode_of_operation` by which the drive is told that mode; None: by its steps."""
        return self._modes.supported(mode).code

    def mode_codes(self) -> list[int]:
        """Values of `mode_of_operation` that are set, in the order in which they may be left."""
        codes = [self._modes.supported(Mode.TORQUE).code]
        if self._profile.modes.get(Mode.POSITION):
            codes.insert(0, self._profile.modes[Mode.POSITION][0].code)
        return [code for code in codes if code is not None]

    def set_points(self) -> frozenset[str]:
        """Mode and set-points that the cycle commands."""
        return SET & set(self._profile.cycle.out)

    def power(self) -> dict[str, tuple[int, ...]]:
        """What energising, stopping and the way back write to parameters that are put back."""
        power = self._profile.power
        steps = (*power.enable, *power.reset) if power is not None else ()
        found: dict[str, tuple[int, ...]] = {}
        for step in (*steps, *self._profile.stop, *self._profile.disable):
            if step.write is None or step.raw is None:
                continue
            parameter = self._access.parameter(step.write)
            kept = parameter.protection in (Protection.EXPERIMENT, Protection.COMMAND)
            # a controlword is a command of the moment, and no setting
            if kept and parameter.access is not Access.WRITE_ONLY and power is not None:
                found[step.write] = (*found.get(step.write, ()), step.raw)
        return found

    def procedures(self) -> dict[str, tuple[Step, ...]]:
        """What enables, stops and disables the drive, and acknowledges a fault."""
        profile, power = self._profile, self._profile.power
        enable = power.enable if power else _told(
            cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE
        )  # fmt: skip
        reset = power.reset if power else _told(0, cia402.FAULT_RESET, 0)
        return {
            "enable": enable, "stop": profile.stop, "disable": profile.disable,
            "acknowledge a fault": reset,
        }  # fmt: skip

    def left_by_a_stop(self) -> dict[str, int]:
        """What the stop path leaves in registers that the machine uses, too."""
        found: dict[str, int] = {}
        for step in (*self._profile.stop, *self._profile.disable):
            if step.write is None or step.raw is None:
                continue
            if self._access.parameter(step.write).protection is Protection.EXPERIMENT:
                found[step.write] = step.raw
        return found

    # -- the bus' own objects --------------------------------------------------------------------

    def bus(self) -> dict[str, tuple[int, int]]:
        """Objects of the bus' own that the cycle changes: what is there, and what will be."""
        return self._access.bus.changes()

    def put_back_bus(self, old: dict[str, int]) -> bool:
        """Write back what `bus` named. False: all was as before."""
        return self._access.bus.put_back(old)


def _told(*words: int) -> tuple[Step, ...]:
    """Controlwords, one after the other."""
    return tuple(Step(write="controlword", raw=word) for word in words)
