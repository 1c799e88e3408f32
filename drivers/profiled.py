"""Any drive that a profile describes, on any bus: the verbs, made from raw accesses."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from math import inf, nan
from typing import TYPE_CHECKING, Never, TypeVar

from drivers import cia402, error_codes
from drivers.bases import interpolation_period, read_bases
from drivers.counter import Counter
from drivers.drive import GUARDS, SET, Bus, Exchange, StopFrames, StopReport
from drivers.errors import AccessDenied, NoAnswer, PreflightRefused, WriteDenied, WriteFailed
from drivers.patience import patiently
from drivers.power import perform, power_of
from drivers.sample import Sample
from drivers.scaling import Scaling
from drivers.stopping import Rest, StopPath
from profiles.axis import Axis
from profiles.errors import UnknownName
from profiles.identity import NOBODY, Identity
from profiles.parameter import Access, Parameter, Protection, Trust
from profiles.procedures import Mode, ModeCode
from profiles.schema import Profile

if TYPE_CHECKING:
    from drivers.serial_port import Stream

__all__ = ["ProfiledDrive"]

_new = tuple.__new__  # a named tuple in half the time: there are hundreds of thousands
_IDENTITY = {
    "product": "product_code", "revision": "revision_code", "serial": "serial_number",
}  # fmt: skip
_WRITTEN = (Protection.EXPERIMENT, Protection.COMPENSATION, Protection.GAIN)
_POLL = 0.005  # s between two looks at a state
_BUSY = 0.05  # s until a busy drive is asked again

T = TypeVar("T")


class ProfiledDrive:
    """A drive on `bus` as `profile` describes it, moving `axis`.

    Raises PreflightRefused when the bases of the scaling cannot be known; `to_stop` does not ask for
    them, so that nothing stands between the user and `stop`.
    """

    dispensable = frozenset({"interpolation_time", "interpolation_exponent", "quick_stop_option"})

    def __init__(
        self, bus: Bus, profile: Profile, axis: Axis, link: str, *, to_stop: bool = False
    ) -> None:
        self.profile = profile
        self.link = link
        self.cycle = bus.cycle
        self.in_real_time = bus.in_real_time
        self.lacking = bus.lacking  # of its profile, and what else is odd about it, in words
        self._bus = bus
        self._power = power_of(bus, profile, self.status_text)
        self._rest_raw = 0
        self._energised = False
        self.scaling = (
            Scaling(1.0, 1.0, axis.mechanics)
            if to_stop
            else read_bases(profile, axis, self._optional)
        )
        revolution = inf if to_stop else self.scaling.increments_per_revolution
        self._stop_path = StopPath(bus, profile, self._power.is_energised, revolution)
        if not profile.moves:
            return
        self._select(Mode.TORQUE, profile.modes[Mode.TORQUE][0])
        names = profile.cycle.in_
        self._at_position = names.index("position_actual")
        self._at_torque = names.index("torque_actual") if "torque_actual" in names else None
        self._position_step = self._step("position_actual")
        self._counter = self._position_counter(to_stop=to_stop)
        self._torque_step = self._step("torque_actual") if self._at_torque is not None else nan
        if not to_stop:
            self.lacking += self._power.peculiarities()

    def _position_counter(self, *, to_stop: bool) -> Counter:
        """It wraps within its position range limit (607Bh), where it has one, else at its type's width."""
        low, high = self._parameter("position_actual").address.raw_range
        if not to_stop:
            least, most = (
                self._optional(name) for name in ("position_range_min", "position_range_max")
            )
            if least is not None and most is not None and low <= least < most <= high:
                low, high = least, most
        return Counter(low, high)

    # -- parameters ------------------------------------------------------------------------------

    def identity(self) -> Identity:
        """Who the drive says it is; from its parameters what the bus does not tell."""
        asked = self.profile.identity.asked
        identity = self._bus.identify() if asked else NOBODY
        told = {}
        for field, name in _IDENTITY.items():
            if not getattr(identity, field) and name in self.profile.parameters:
                told[field] = f"0x{self.read_raw(name):08X}"
        return identity.model_copy(update=told)

    def read(self, name: str) -> float:
        """Value of a parameter, SI at the axis."""
        raw = self.read_raw(name)
        if name == "position_actual" and self.profile.moves:
            raw = self._counter.follow(raw)
        return self.scaling.to_si(self._parameter(name), raw)

    def read_raw(self, name: str) -> int:
        """Raw value of a parameter; raises LinkError, AccessDenied."""
        parameter = self._parameter(name)
        if parameter.access is Access.WRITE_ONLY:
            raise WriteFailed(f"'{name}' ({parameter.address}) can only be written")
        try:
            return self._patiently(lambda: self._bus.read(parameter.address))
        except AccessDenied as error:
            raise AccessDenied(f"'{name}': {error}", busy=error.busy) from None

    def _optional(self, name: str) -> int | None:
        """Raw value of what not every drive has; None where this one has it not. Raises LinkError."""
        if name not in self.profile.parameters:
            return None
        try:
            return self.read_raw(name)
        except AccessDenied as error:
            if error.busy:
                raise
            return None

    def _patiently(self, action: Callable[[], T]) -> T:
        """What `action` gives, asked again while the drive says that it is busy."""
        return patiently(action, self.profile.link.patience, lambda: self._pause(_BUSY))

    def write(self, name: str, value: float) -> None:
        """Write an experiment or compensation parameter (SI) and read it back."""
        parameter = self._parameter(name)
        self.write_raw(name, self.scaling.checked_raw(name, parameter, value))

    def write_raw(self, name: str, raw: int) -> None:
        """Write a raw value and read it back; raises WriteFailed, LinkError."""
        parameter = self._parameter(name)
        if parameter.protection is Protection.COMMAND and (
            name in SET or name in self.power_changes()
        ):
            if self.is_energised():
                raise WriteFailed(f"'{name}' is not put back while the drive is enabled")
        elif parameter.protection not in _WRITTEN:
            raise WriteFailed(
                f"'{name}' has protection '{parameter.protection}' in profile "
                f"'{self.profile.name}': it is not written"
            )
        for_good = parameter.protection not in (Protection.EXPERIMENT, Protection.COMMAND)
        if for_good and parameter.trust is Trust.UNVERIFIED:
            raise WriteFailed(
                f"'{name}' ({parameter.address}) is unverified in profile '{self.profile.name}': "
                "it is not written; check the drive's manual and mark it in the profile"
            )
        low, high = parameter.range
        if not parameter.allows(raw):
            raise WriteFailed(f"'{name}': raw value {raw} is not allowed ({low:g}…{high:g})")
        try:
            if name == "mode_of_operation":
                self._write_mode(raw)
            else:
                self._patiently(lambda: self._bus.write(parameter.address, raw))
        except WriteDenied as error:
            raise WriteDenied(f"'{name}': {error}", busy=error.busy) from None
        except NoAnswer:
            # its answer may be lost, and not the write: what stands there tells, and nothing is sent twice
            if parameter.access is Access.WRITE_ONLY or self.read_raw(name) != raw:
                raise
            return
        self._verify(name, parameter, raw)

    def _verify(self, name: str, parameter: Parameter, raw: int) -> None:
        if parameter.access is Access.WRITE_ONLY:
            return
        there = self._patiently(lambda: self._bus.read(parameter.address))
        if there != raw:
            raise WriteFailed(
                f"'{name}' ({parameter.address}) reads back {there} after {raw} was written: "
                "the drive did not take it"
            )

    def store(self) -> None:
        """Run the profile's store procedure; raises WriteFailed."""
        if self.profile.store is None:
            raise WriteFailed(
                f"profile '{self.profile.name}' has no store procedure: the values are lost at "
                "power-off"
            )
        if self.is_energised():
            raise WriteFailed("nothing is stored while the drive is enabled: disable it first")
        steps = self.profile.store.steps
        patience = self.profile.patience.save
        with self._bus.answering_within(patience):  # some are silent while they store
            perform(self._bus, self.profile, steps, "store", lambda: self._pause(_POLL), patience)
            # and some are busy after they have said that it is done
            patiently(self._power.is_energised, patience, lambda: self._pause(_BUSY))

    def watchdog_settings(self) -> dict[str, int]:
        """Raw value of each parameter that arms the drive-side watchdog; empty: it has none."""
        watchdog = self.profile.watchdog
        if watchdog.parameter is None or watchdog.kind == "none":
            return {}
        raw = self.scaling.to_raw(self._parameter(watchdog.parameter), watchdog.timeout)
        if watchdog.kind == "heartbeat":
            raw |= watchdog.node << 16  # CiA 301, object 1016h: node in bits 16-23
        settings = {watchdog.parameter: raw}
        if watchdog.kind == "guarding" and watchdog.life_factor is not None:
            settings = {watchdog.parameter: max(1, raw // GUARDS), watchdog.life_factor: GUARDS}
        if watchdog.reaction is not None and watchdog.reaction_raw is not None:
            settings[watchdog.reaction] = watchdog.reaction_raw
        return settings

    def mode_codes(self) -> list[int]:
        """Values of `mode_of_operation` that a job may set, in the order in which it may leave them."""
        codes = [self._supported(Mode.TORQUE).code]
        if self.profile.modes.get(Mode.POSITION):
            codes.insert(0, self.profile.modes[Mode.POSITION][0].code)
        return [code for code in codes if code is not None]

    def exclusive_access(self) -> dict[str, int]:
        """Raw value of the parameter that locks other masters out, where the drive has one."""
        lock = self.profile.exclusive
        return {lock.write: lock.raw} if lock and lock.write and lock.raw is not None else {}

    def preparations(self, mode: Mode) -> dict[str, int]:
        """Raw value of each parameter that `mode` needs set before it is enabled."""
        steps = self._supported(mode).before
        found = self.exclusive_access() | self._standard_preparations()
        found |= {s.write: s.raw for s in steps if s.write is not None and s.raw is not None}
        host = self.profile.compensation.host
        if host is not None and self._is_set(host):
            found[host] = 0  # it would act on top of every command
        return found

    def _standard_preparations(self) -> dict[str, int]:
        """What CiA 402 asks of any mode: the period of the set-points (60C2h), and a quick stop that ends."""
        found: dict[str, int] = {}
        value, power = (
            self._optional("interpolation_time"),
            self._optional("interpolation_exponent"),
        )
        if value is not None and power is not None:
            told, exponent = interpolation_period(self.cycle)
            found = {"interpolation_time": told, "interpolation_exponent": exponent}
        option = self._optional("quick_stop_option")
        if option is not None and option >= cia402.STAYS_IN_QUICK_STOP:
            found["quick_stop_option"] = cia402.QUICK_STOP_RAMP
        return found

    def power_changes(self) -> dict[str, tuple[int, ...]]:
        """Raw values that energising, stopping and the way back write to parameters that are put back."""
        power = self.profile.power
        steps = (*power.enable, *power.reset) if power is not None else ()
        found: dict[str, tuple[int, ...]] = {}
        for step in (*steps, *self.profile.stop, *self.profile.disable):
            if step.write is None or step.raw is None:
                continue
            parameter = self._parameter(step.write)
            kept = parameter.protection in (Protection.EXPERIMENT, Protection.COMMAND)
            # a controlword is a command of the moment, and no setting
            if kept and parameter.access is not Access.WRITE_ONLY and power is not None:
                found[step.write] = (*found.get(step.write, ()), step.raw)
        return found

    def bus_changes(self) -> dict[str, tuple[int, int]]:
        """Objects of the bus' own that the cycle changes in the drive: what is there, and what will be."""
        return self._bus.changes()

    def put_back_bus(self, old: dict[str, int]) -> bool:
        """Write back what `bus_changes` named. False: all was as before."""
        return self._bus.put_back(old)

    def _is_set(self, name: str) -> bool:
        """Whether an object that not every drive has is there, and not zero."""
        try:
            return self.read_raw(name) != 0
        except AccessDenied:
            return False

    def check_requirements(self) -> None:
        """Read what the profile requires of the drive; raises PreflightRefused, and writes nothing."""
        for condition in self.profile.requires:
            there = self.read_raw(condition.parameter)
            if not condition.holds(there):
                parameter = self._parameter(condition.parameter)
                raise PreflightRefused(
                    f"'{condition.parameter}' ({parameter.address}, {parameter.title}) reads {there}, and "
                    f"{condition}: set it in the drive first"
                )

        self._check_enabling_value()

    def _check_enabling_value(self) -> None:
        """Refuse a drive whose enabling register holds the enabling value by itself: it would be put back."""
        power = self.profile.power
        prepared = self.preparations(Mode.TORQUE)
        for step in power.enable if power is not None else ():
            if step.write not in prepared or step.raw in (None, prepared[step.write]):
                continue
            if self.read_raw(step.write) == step.raw:
                raise PreflightRefused(
                    f"'{step.write}' ({self._parameter(step.write).address}) reads {step.raw}, which "
                    "enables the drive: what uses it? Set it to another value first"
                )

    # -- energy ----------------------------------------------------------------------------------

    def status_text(self) -> str:
        """State of the drive in words, with what it reported."""
        text, trouble = self._state_text(), self._bus.trouble()
        return f"{text}, {trouble}" if trouble else text

    def fault_of_another_kind(self) -> str:
        """An error code that is none of communication, in words; ''."""
        code = self._error_code()
        is_known = self.profile.power is None and not error_codes.is_of_communication(code)
        return f"{code:04X}h, {error_codes.words(code)}" if is_known else ""

    def _error_code(self) -> int:
        return self._optional("error_code") or 0

    def _state_text(self) -> str:
        text, code = self._patiently(self._power.text), self._error_code()
        if not code:
            return text
        meaning = error_codes.words(code) if self.profile.power is None else ""
        return f"{text}, error code {code:04X}h{meaning and f' ({meaning})'}"

    def fault_text(self) -> str:
        """Fault and its code in words, or 'no fault'."""
        return self._state_text() if self.in_fault() else "no fault"

    def is_energised(self) -> bool:
        """Whether the drive says that it controls the axis."""
        return self._patiently(self._power.is_energised)

    def other_master(self) -> str:
        """What another master sent on the same bus, or ''."""
        return self._bus.other_master()

    def in_fault(self) -> bool:
        """Whether the drive reports a fault."""
        return self._patiently(self._power.in_fault)

    def reset_fault(self) -> None:
        """Acknowledge a fault; never enables. Raises PreflightRefused when the fault stays."""
        self._power.acknowledge()
        if not self._comes(lambda: not self.in_fault(), self.profile.patience.reset):
            raise PreflightRefused(
                f"the drive stays in fault after a reset: {self.status_text()}; remove its cause"
            )

    def _comes(self, sign: Callable[[], bool], patience: float) -> bool:
        """Whether `sign` is given within `patience` s."""
        until = self._bus.now() + patience
        while not sign():
            if self._bus.now() >= until:
                return False
            self._bus.wait(_POLL)
        return True

    def enable(self, mode: Mode, rest: float = 0.0) -> None:
        """Energise in `mode` with `rest` (SI) as the set-point in force from the first moment."""
        if self.in_fault():
            raise PreflightRefused(
                f"the drive is in fault: {self.status_text()}; remove the cause and reset it"
            )
        code = self._supported(mode)
        self._select(mode, code)
        if code.code is not None:
            self._set_mode(code.code)
        target = self._parameter(code.set_point)
        self._rest_raw = (
            self.read_raw("position_actual")
            if mode is Mode.POSITION
            else round(rest / self._set_point_step)
        )
        if not self._lowest <= self._rest_raw <= self._highest:
            self._refuse_set_point(code.set_point, self._rest_raw)
        with contextlib.suppress(NoAnswer):  # it is looked at
            self._patiently(lambda: self._bus.write(target.address, self._rest_raw))
        self._verify(code.set_point, target, self._rest_raw)
        self._bus.start(self._frame(self._rest_raw))
        self._energised = True
        self._power.enable(list(self._frame(self._rest_raw)))

    def disable(self) -> None:
        """Take the energy away from an axis at rest; raises LinkError, DriveFault."""
        self._power.disable(list(self._frame(self._rest_raw)))
        self._energised = False
        self._patiently(self._rest)

    def _rest(self) -> None:
        """Zero as the torque command of a drive without energy: no stale one waits for the next master."""
        if self._mode is not Mode.TORQUE:
            return
        try:
            self._bus.write(self._set_point.address, 0)
        except NoAnswer:
            if self._bus.read(self._set_point.address) != 0:
                raise

    def refuse_rehearsal(self) -> None:
        """Raises PreflightRefused where the cycle must not be exchanged without an experiment."""
        if self.is_energised():
            raise PreflightRefused(
                "the drive is enabled, so somebody else controls it: its cycle is not disturbed"
            )
        steps = self._supported(Mode.TORQUE).before
        settings = [s.write for s in steps if s.write is not None and s.write not in SET]
        if self.profile.power is not None and settings:
            raise PreflightRefused(
                f"a cycle of profile '{self.profile.name}' needs {settings[0]} set before (or the drive may "
                "store each command): the experiment does that, and puts it back; this measurement writes no "
                "setting. 'tworelay identify' tells how late its cycles were"
            )

    def rehearse(self, count: int) -> Iterator[Exchange]:
        """`count` cycles of the exchange with every output at zero; the drive stays de-energised.

        Raises PreflightRefused where it is energised, LinkError.
        """
        self.refuse_rehearsal()
        zeros = (0,) * len(self.profile.cycle.out)
        self._bus.start(zeros)
        for _ in range(count):
            yield self._bus.exchange(zeros)

    def _supported(self, mode: Mode) -> ModeCode:
        codes = self.profile.modes.get(mode, ())
        if not codes and mode is Mode.TORQUE:
            raise PreflightRefused(
                f"profile '{self.profile.name}' has no torque command, so no relay experiment can be "
                "run: record a motion with the drive's own software, and give it to 'tworelay analyze FILE "
                "--for AXIS'"
            )
        if not codes:
            raise PreflightRefused(f"profile '{self.profile.name}' has no {mode} mode")
        bits = self._optional("supported_modes")
        if bits is None:
            return codes[0]
        for code in codes:
            if code.supported_bit is None or bits >> code.supported_bit & 1:
                return code
        wanted = " or ".join(str(code.code) for code in codes)
        raise PreflightRefused(
            f"the drive supports no {mode} mode: supported modes {bits:08X}h lack mode {wanted}"
        )

    def _set_mode(self, code: int) -> None:
        patience = self.profile.patience.mode
        self._write_mode(code)
        if self._comes(lambda: self.read_raw("mode_display") == code, patience):
            return
        raise PreflightRefused(
            f"the drive stays in mode {self.read_raw('mode_display')} instead of {code} for {patience:g} s; "
            "if it needs longer, say so in its profile: [patience] mode"
        )

    def _write_mode(self, code: int) -> None:
        """Tell the drive its mode; to some that of before is an error, or any while HALT is set."""
        address = self._parameter("mode_of_operation").address
        if self._patiently(lambda: self._bus.read(address)) == code:
            return
        try:
            with contextlib.suppress(NoAnswer):  # the mode display tells
                self._bus.write(address, code)
        except WriteDenied as error:
            control = self.profile.parameters.get("controlword")
            if not error.busy:
                raise WriteDenied(
                    f"{error}; has this drive mode {code}? (6502h, and [[modes]] of its profile)"
                ) from None
            if self.profile.power is not None or control is None:
                raise
            self._patiently(lambda: self._bus.write(control.address, cia402.DISABLE_VOLTAGE))
            self._patiently(lambda: self._bus.write(address, code))

    def _select(self, mode: Mode, code: ModeCode) -> None:
        self._mode = mode
        self._set_point = self._parameter(code.set_point)
        self._set_point_name = code.set_point
        self._set_point_step = self._step(code.set_point)
        self._lowest, self._highest = self._set_point.range
        out = self.profile.cycle.out
        if code.set_point not in out:
            raise PreflightRefused(
                f"profile '{self.profile.name}' does not exchange '{code.set_point}' in its cycle"
            )
        self._at_set_point = out.index(code.set_point)
        self._idle = self._power.idle()

    # -- cycle -----------------------------------------------------------------------------------

    def exchange(self, set_point: float) -> Sample:
        """Put `set_point` (SI) in force and return the first sample latched after that."""
        offset = self._counter.offset if self._mode is Mode.POSITION else 0
        raw = round(set_point / self._set_point_step) - offset
        if not self._lowest <= raw <= self._highest:
            self._refuse_set_point(self._set_point_name, raw)
        values, in_force, sent, time, lateness, missed = self._bus.exchange(self._frame(raw))
        at_torque = self._at_torque
        return _new(
            Sample,
            (
                time,
                self._counter.follow(values[self._at_position]) * self._position_step,
                nan if at_torque is None else values[at_torque] * self._torque_step,
                (in_force[self._at_set_point] + offset) * self._set_point_step,
                sent,
                self._power.status(values),
                lateness,
                missed,
            ),
        )

    def check_set_points(self, mode: Mode, largest: float) -> None:
        """Raises PreflightRefused where ±`largest` (SI) does not fit the set-point of `mode`."""
        name = self._supported(mode).set_point
        low, high = self._parameter(name).range
        for value in (-largest, largest):
            raw = round(value / self._step(name))
            if not low <= raw <= high:
                self._refuse_set_point(name, raw)

    def _refuse_set_point(self, name: str, raw: int) -> Never:
        """Raises PreflightRefused: nothing like it goes onto the wire."""
        parameter, step = self._parameter(name), self._step(name)
        (low, high), unit = parameter.range, self.scaling.unit_text(parameter)
        raise PreflightRefused(
            f"{raw * step:.4g} {unit} is {raw} of '{name}' ({parameter.address}), which takes {low:.0f}…"
            f"{high:.0f}, that is {low * step:.4g}…{high * step:.4g} {unit}: is its scale right in profile "
            f"'{self.profile.name}', and are gear, rated_torque and encoder in the axis file?"
        )

    def _frame(self, raw: int) -> tuple[int, ...]:
        self._idle[self._at_set_point] = raw
        return tuple(self._idle)

    def wait(self, seconds: float) -> None:
        """Let time pass without a command."""
        self._bus.wait(seconds)

    # -- stop ------------------------------------------------------------------------------------

    def stop_frames(self) -> StopFrames | None:
        """What another process writes to our port to stop the drive; None: it connects by itself."""
        return self._stop_path.frames(Rest(self._set_point.address, self._rest_raw))

    def speak_through(self, stream: Stream | None) -> None:
        """Give the serial port back and speak through `stream` from now on; None: through nothing, yet."""
        self._bus.speak_through(stream)

    def stop(self, hurry: Callable[[], bool] = lambda: False) -> StopReport:
        """Stop the axis and take the energy away, as far as it can be done. Never raises.

        `hurry` says that the energy must go now, without waiting for standstill.
        """
        rest = Rest(self._set_point.address, self._rest_raw)
        report = self._stop_path.stop(rest, hurry, self._rest)
        self._energised = report.deenergised is False
        return report

    def close(self) -> None:
        """Stop what is still energised, and let go of the link."""
        try:
            if self._energised:
                self.stop()
        finally:
            self._bus.close()

    def _pause(self, seconds: float) -> float:
        self._bus.wait(seconds)
        return seconds

    def _parameter(self, name: str) -> Parameter:
        try:
            return self.profile.parameters[name]
        except KeyError:
            raise UnknownName(
                f"parameter in profile '{self.profile.name}'", name, list(self.profile.parameters)
            ) from None

    def _step(self, name: str) -> float:
        return self.scaling.step(self._parameter(name))
