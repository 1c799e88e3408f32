"""Any drive that a profile describes, on any bus: the verbs, made from raw accesses."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import inf, nan

from drivers import error_codes
from drivers.access import POLL, RawAccess
from drivers.bases import read_bases
from drivers.bus import SET, Bus, StopFrames
from drivers.counter import Counter
from drivers.described import described
from drivers.drive import DriveSays, StopReport, Value
from drivers.errors import (
    AccessDenied,
    LinkError,
    NoAnswer,
    PreflightRefused,
    WriteDenied,
    WriteFailed,
)
from drivers.line import Line
from drivers.modes import Modes, SetPoint
from drivers.power import perform, power_of
from drivers.preparation import Preparation
from drivers.rehearsal import Rehearsal
from drivers.sample import Sample
from drivers.scaling import Scaling
from drivers.stopping import Rest, StopPath
from drivers.writing import why_not_written
from profiles.axis import Axis
from profiles.identity import NOBODY, Identity
from profiles.parameter import Protection
from profiles.procedures import Mode
from profiles.schema import Profile

__all__ = ["ProfiledDrive"]

_new = tuple.__new__  # a named tuple in half the time: there are hundreds of thousands
_IDENTITY = {
    "product": "product_code", "revision": "revision_code", "serial": "serial_number",
}  # fmt: skip


class ProfiledDrive:
    """A drive on `bus` as `profile` describes it, moving `axis`.

    Raises PreflightRefused when the bases of the scaling cannot be known; `to_stop` does not ask
    for them, so that nothing stands between the user and `stop`.
    """

    def __init__(
        self, bus: Bus, profile: Profile, axis: Axis, link: str, *, to_stop: bool = False
    ) -> None:
        self.link = link
        self.cycle = bus.cycle
        self.in_real_time = bus.in_real_time
        self.lacking = bus.lacking  # of its profile, and what else is odd about it, in words
        self.profile = profile
        self.watchdog = profile.watchdog
        self.moves = profile.moves
        self.tells_torque = "torque_actual" in profile.cycle.in_
        self.stop_time = profile.stop_time
        self.limits: Mapping[str, str] = dict(profile.limits.items())
        self.compensation = profile.compensation
        self.loops = profile.loops
        self.memory = profile.store
        self.own_estimates: Mapping[str, str] = dict(profile.own_estimates.items())
        self.conditions: Mapping[str, str] = dict(profile.conditions.items())

        self._bus = bus
        self._access = access = RawAccess(bus, profile)
        self._power = power_of(bus, profile, lambda: self.state().text)
        self._rest_raw = 0
        self._energised = False
        self.scaling = (
            Scaling(1.0, 1.0, axis.mechanics)
            if to_stop
            else read_bases(profile, axis, access.optional)
        )
        self.parameters = described(
            profile, self.scaling, constant_known=axis.torque_constant is not None
        )
        self._modes = modes = Modes(access)
        self.preparation = Preparation(access, modes, self.parameters)
        self.rehearsal = Rehearsal(access, modes, self._is_energised)
        self.line = Line(bus, self._stop_frames)
        revolution = inf if to_stop else self.scaling.increments_per_revolution
        self._stop_path = StopPath(bus, profile, self._power.is_energised, revolution)
        if not profile.moves:
            return
        torque = profile.modes[Mode.TORQUE][0]
        self._set_point = SetPoint(Mode.TORQUE, torque, self.parameters, access)
        self._idle = self._power.idle()
        names = profile.cycle.in_
        self._at_position = names.index("position_actual")
        self._at_torque = names.index("torque_actual") if self.tells_torque else None
        self._position_step = self.parameters["position_actual"].step
        self._counter = self._position_counter(to_stop=to_stop)
        self._torque_step = self.parameters["torque_actual"].step if self.tells_torque else nan
        if not to_stop:
            self.lacking += self._power.peculiarities()

    def _position_counter(self, *, to_stop: bool) -> Counter:
        """It wraps within its position range limit (607Bh), else at its type's width."""
        low, high = self._access.parameter("position_actual").address.raw_range
        if not to_stop:
            least = self._access.optional("position_range_min")
            most = self._access.optional("position_range_max")
            if least is not None and most is not None and low <= least < most <= high:
                low, high = least, most
        return Counter(low, high)

    # -- parameters ------------------------------------------------------------------------------

    def identity(self) -> Identity:
        """Who the drive says it is; from its parameters what the bus does not tell."""
        identity = self._bus.identify() if self.profile.identity.asked else NOBODY
        told = {}
        for field, name in _IDENTITY.items():
            if not getattr(identity, field) and name in self.parameters:
                told[field] = f"0x{self._access.read(name):08X}"
        return identity.model_copy(update=told)

    def read(self, name: str) -> Value:
        """Value of a parameter; raises LinkError, AccessDenied.

        A position that wraps is unwrapped in SI.
        """
        what = self.parameters[name]
        raw = self._access.read(name)
        whole = raw
        if name == "position_actual" and self.moves:
            whole = self._counter.follow(raw)
        return Value(raw, what.si(whole))

    def write(self, name: str, raw: int) -> None:
        """Write a raw value and read it back; raises WriteFailed, LinkError."""
        what = self.parameters[name]
        commands = name in SET or name in self.preparation.power()
        is_command = what.protection is Protection.COMMAND and commands
        if is_command and self._is_energised():
            raise WriteFailed(
                f"'{name}' is not put back while the drive is enabled",
                code="write.enabled",
                parameter=name,
            )
        refused = why_not_written(what, raw, is_command=is_command)
        if refused is not None:
            raise WriteFailed(refused.text, code=refused.code, hint=refused.hint, parameter=name)
        try:
            if name == "mode_of_operation":
                self._modes.write(raw)
            else:
                self._access.write_surely(name, raw)
        except WriteDenied as error:
            raise WriteDenied(f"'{name}': {error}", busy=error.busy) from None
        self._access.verify(name, raw)

    def store(self) -> None:
        """Run the profile's store procedure; raises WriteFailed."""
        if self.memory is None:
            raise WriteFailed(
                f"{self.profile} has no store procedure: the values are lost at power-off",
                code="store.none",
            )
        if self._is_energised():
            raise WriteFailed(
                "nothing is stored while the drive is enabled: disable it first",
                code="store.enabled",
            )
        steps, access = self.memory.steps, self._access
        patience = self.profile.patience.save
        with self._bus.answering_within(patience):  # some are silent while they store
            perform(self._bus, self.profile, steps, "store", lambda: access.pause(POLL), patience)
            # and some are busy after they have said that it is done
            access.patiently(self._power.is_energised, patience)

    # -- energy ----------------------------------------------------------------------------------

    def state(self) -> DriveSays:
        """What the drive says of itself; raises LinkError.

        Of a drive with energy and no fault nothing more is asked: it may have to be stopped.
        """
        said = self._access.patiently(self._power.said)
        asks = said.in_fault or not said.is_energised
        code, trouble = self._error_code() if asks else None, self._bus.trouble()
        text, stranger = said.text, ""
        if code:
            meaning = error_codes.words(code) if self.profile.power is None else ""
            told = self.profile.fault(code) or meaning
            text += f", error code {code:04X}h{told and f' ({told})'}"
            if meaning and not error_codes.is_of_communication(code):
                stranger = f"{code:04X}h, {meaning}"
        elif asks and code is None:
            text += ", and its error code could not be read"
        return DriveSays(
            said.is_energised,
            said.in_fault,
            f"{text}, {trouble}" if trouble else text,
            text if said.in_fault else "no fault",
            code,
            stranger,
        )

    def _error_code(self) -> int | None:
        """0: none, or the drive has no such object; None: it did not tell."""
        if "error_code" not in self.parameters:
            return 0
        try:
            return self._bus.read(self._access.parameter("error_code").address)
        except AccessDenied as denied:
            return None if denied.busy else 0
        except LinkError:
            return None

    def _is_energised(self) -> bool:
        return self._access.patiently(self._power.is_energised)

    def _in_fault(self) -> bool:
        return self._access.patiently(self._power.in_fault)

    def reset_fault(self) -> None:
        """Acknowledge a fault; never enables. Raises PreflightRefused when the fault stays."""
        self._power.acknowledge()
        if not self._access.comes(lambda: not self._in_fault(), self.profile.patience.reset):
            raise PreflightRefused(
                f"the drive stays in fault after a reset: {self.state().text}",
                code="fault.stays",
                hint="remove its cause",
            )

    def enable(self, mode: Mode, rest: float = 0.0) -> None:
        """Energise in `mode` with `rest` (SI) as the set-point in force from the first moment."""
        if self._in_fault():
            raise PreflightRefused(
                f"the drive is in fault: {self.state().text}",
                code="preflight.fault",
                hint="remove the cause and reset it",
            )
        code = self._select(mode)
        if code is not None:
            self._modes.set(code)
        target = self._set_point
        self._rest_raw = (
            self._access.read("position_actual")
            if mode is Mode.POSITION
            else round(rest / target.step)
        )
        target.check(self._rest_raw)
        self._access.write_surely(target.name, self._rest_raw)
        self._access.verify(target.name, self._rest_raw)
        self._bus.start(self._frame(self._rest_raw))
        self._energised = True
        self._power.enable(list(self._frame(self._rest_raw)))

    def disable(self) -> None:
        """Take the energy away from an axis at rest; raises LinkError, DriveFault."""
        self._power.disable(list(self._frame(self._rest_raw)))
        self._energised = False
        self._access.patiently(self._rest)

    def _rest(self) -> None:
        """Zero as the torque command of a drive without energy.

        No stale one waits for the next master.
        """
        if self._set_point.mode is not Mode.TORQUE:
            return
        address = self._set_point.address
        try:  # no patience: the stop path ends with this
            self._bus.write(address, 0)
        except NoAnswer:
            if self._bus.read(address) != 0:
                self._bus.write(address, 0)

    def _select(self, mode: Mode) -> int | None:
        """Command the set-point of a mode from now on; returns the mode's code."""
        code = self._modes.supported(mode)
        self._set_point = SetPoint(mode, code, self.parameters, self._access)
        self._idle = self._power.idle()
        return code.code

    # -- cycle -----------------------------------------------------------------------------------

    def exchange(self, set_point: float) -> Sample:
        """Put `set_point` (SI) in force and return the first sample latched after that."""
        target = self._set_point
        offset = self._counter.offset if target.mode is Mode.POSITION else 0
        raw = round(set_point / target.step) - offset
        if not target.lowest <= raw <= target.highest:
            target.refuse(raw)
        values, in_force, sent, time, lateness, missed = self._bus.exchange(self._frame(raw))
        at_torque = self._at_torque
        return _new(
            Sample,
            (
                time,
                self._counter.follow(values[self._at_position]) * self._position_step,
                nan if at_torque is None else values[at_torque] * self._torque_step,
                (in_force[target.at] + offset) * target.step,
                sent,
                self._power.status(values),
                lateness,
                missed,
            ),
        )

    def _frame(self, raw: int) -> tuple[int, ...]:
        self._idle[self._set_point.at] = raw
        return tuple(self._idle)

    def wait(self, seconds: float) -> None:
        """Let time pass without a command."""
        self._bus.wait(seconds)

    # -- stop ------------------------------------------------------------------------------------

    def _stop_frames(self) -> StopFrames | None:
        return self._stop_path.frames(Rest(self._set_point.address, self._rest_raw))

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
