"""Energy on and off.

By the CiA 402 state machine, or by the procedure that a profile writes down.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import NamedTuple, Protocol, TypeVar

from drivers import cia402
from drivers.bus import Bus
from drivers.errors import DriveFault, NoAnswer, PreflightRefused, WriteDenied, WriteFailed
from drivers.patience import patiently
from drivers.sample import Status
from profiles.procedures import Condition, Power, Step
from profiles.schema import Profile

__all__ = ["Cia402Power", "PowerStage", "ProcedurePower", "perform", "power_of"]

_POLL = 0.005  # s between two looks at a state
_BUSY = 0.05  # s until a busy drive is asked again

_MOST_RETOLD = 3
_TOLD_AGAIN = 10  # cycles after which a controlword that nobody heard is told again

_WAY_UP = "switch on disabled", "ready to switch on", "switched on", "operation enabled"

T = TypeVar("T")
Frame = list[int]  # raw values of cycle.out


class Said(NamedTuple):
    """What a drive says of its energy at one look; `text` is its state in words."""

    is_energised: bool
    in_fault: bool
    text: str


class PowerStage(Protocol):
    """What can be done with a drive's energy, and what the drive says of it."""

    def peculiarities(self) -> tuple[str, ...]:
        """What it says at rest that can mean nothing, in words; it is not heeded from now on."""

    def said(self) -> Said:
        """All that it says at one look."""

    def is_energised(self) -> bool:
        """Whether the drive says that it controls the axis."""

    def in_fault(self) -> bool:
        """Whether the drive reports a fault."""

    def acknowledge(self) -> None:
        """Reset a fault; never enables."""

    def idle(self) -> Frame:
        """Raw values of cycle.out that keep an enabled drive enabled, all set-points zero."""

    def enable(self, frame: Frame) -> None:
        """Energise while `frame` is exchanged; raises DriveFault, PreflightRefused."""

    def disable(self, frame: Frame) -> None:
        """Take the energy away likewise."""

    def status(self, values: tuple[int, ...]) -> Status:
        """What the raw values of cycle.in say."""


def power_of(bus: Bus, profile: Profile, describe: Callable[[], str]) -> PowerStage:
    """The power stage of the drive that `profile` describes; `describe` says what it reports."""
    if profile.power is None:
        return Cia402Power(bus, profile, describe)
    return ProcedurePower(bus, profile, profile.power, describe)


def perform(
    bus: Bus,
    profile: Profile,
    steps: tuple[Step, ...],
    what: str,
    wait: Callable[[], float],
    patience: float | None = None,
) -> None:
    """Write and wait as `steps` say; `wait` lets some time pass and says how much, s.

    A drive that says it is busy is asked again, for `patience` s (default: the link's). Raises
    WriteFailed when a wait is in vain, LinkError.
    """
    patience = profile.link.patience if patience is None else patience
    for step in steps:
        if step.write is not None and step.raw is not None:
            address, raw = profile.parameters[step.write].address, step.raw
            try:
                patiently(lambda a=address, r=raw: bus.write(a, r), patience, wait)  # type: ignore[misc]
            except WriteDenied as error:
                raise WriteDenied(f"{what}: '{step.write}': {error}", busy=error.busy) from None
            continue
        name = step.until or ""
        address = profile.parameters[name].address
        waited = 0.0
        while True:
            there = patiently(lambda a=address: bus.read(a), patience, wait)  # type: ignore[misc]
            if there & step.mask == step.equals:
                break
            if waited >= step.within:
                raise WriteFailed(
                    f"{what}: '{name}' reads {there} for {step.within:g} s instead of "
                    f"{step.equals}",
                    code="procedure.in-vain",
                )
            waited += wait()


class Cia402Power:
    """The state machine of CiA 402: controlword and statusword."""

    def __init__(self, bus: Bus, profile: Profile, describe: Callable[[], str]) -> None:
        self._bus = bus
        self._describe = describe
        self._patience = profile.patience.enable
        self._busy = profile.link.patience
        self._control = profile.parameters["controlword"].address
        self._state = profile.parameters["statusword"].address
        out = profile.cycle.out
        self._width = len(out)
        self._at_control = out.index("controlword") if "controlword" in out else None
        self._at_status = profile.cycle.in_.index("statusword")
        self._told = ~0  # bits of the statusword that tell something

    def peculiarities(self) -> tuple[str, ...]:
        """What it says at rest that can mean nothing, in words; it is not heeded from now on."""
        status = cia402.status(self._patiently(self._word, self._pause))
        if not status.limit or status.enabled or status.stopping:
            return ()
        self._told = ~cia402.INTERNAL_LIMIT
        text = (
            "the drive says at rest, without energy, that an internal limit is active (6041h, bit "
            "11): that bit tells nothing here, and is not heeded"
        )
        return (text,)

    def _word(self) -> int:
        return self._bus.read(self._state)

    def said(self) -> Said:
        """What its statusword says."""
        word = self._word()
        status = cia402.status(word)
        return Said(status.enabled or status.stopping, status.fault, cia402.state(word))

    def is_energised(self) -> bool:
        """Whether the drive says that it controls the axis."""
        return self.said().is_energised

    def in_fault(self) -> bool:
        """Whether the drive reports a fault."""
        return self.said().in_fault

    def acknowledge(self) -> None:
        """A rising edge of the controlword's fault reset."""
        for word in (0, cia402.FAULT_RESET, 0):
            self._tell(word, self._pause)

    def _patiently(self, action: Callable[[], T], wait: Callable[[], float]) -> T:
        """What `action` gives; `wait` lets time pass until a busy drive is asked again."""
        return patiently(action, self._busy, wait)

    def _tell(self, word: int, wait: Callable[[], float]) -> bool:
        """A controlword.

        False: no answer says that it was heard; the next look at the state tells.
        """
        with contextlib.suppress(NoAnswer):
            self._patiently(lambda: self._bus.write(self._control, word), wait)
            return True
        return False

    def _pause(self) -> float:
        self._bus.wait(_BUSY)
        return _BUSY

    def idle(self) -> Frame:
        """Zeros, and 'enable operation' where the controlword is in the cycle."""
        frame = [0] * self._width
        if self._at_control is not None:
            frame[self._at_control] = cia402.ENABLE
        return frame

    def enable(self, frame: Frame) -> None:
        """Walk to 'operation enabled'."""
        self._walk(frame, enabled=True)

    def disable(self, frame: Frame) -> None:
        """Walk to 'switch on disabled'."""
        self._walk(frame, enabled=False)

    def _walk(self, frame: Frame, *, enabled: bool) -> None:
        """One transition at a time, the cycle running all the while."""
        goals = ("operation enabled",) if enabled else ("switch on disabled", "fault")
        at = self._at_control
        if at is not None:
            frame[at] = cia402.SHUTDOWN if enabled else cia402.SWITCH_ON
        sent: tuple[str, int] | None = None
        cycles = reached = 0
        heard, retold = True, 0

        def turn() -> float:
            """The cycle feeds the drive's watchdog while brake and ramps take their time."""
            self._bus.exchange(tuple(frame))
            return self._bus.cycle

        while True:
            word = self._patiently(self._word, turn)
            here = cia402.state(word)
            if here in goals:
                return
            if enabled and cia402.status(word).fault:
                raise DriveFault(
                    f"the drive went into fault while enabling: {self._describe()}",
                    code="power.fault",
                )
            height = _WAY_UP.index(here) if here in _WAY_UP else 0
            if enabled and height < reached:
                raise DriveFault(
                    f"the drive fell back to '{here}' while it was enabled (STO, a limit switch, "
                    "an enable input; or its watchdog, for which this link is too slow: 'tworelay "
                    f"latency'): {self._describe()}; it is not tried again",
                    code="power.fell-back",
                )
            reached = height
            step = cia402.next_controlword(word, enabled=enabled)
            if step is not None and sent != (here, step):
                if step == cia402.ENABLE:
                    turn()  # which notices a drive that has restarted
                if at is not None:
                    frame[at] = step
                heard, retold = self._tell(step, turn), 0
                sent, cycles = (here, step), 0
            elif cycles * self._bus.cycle >= self._patience:
                raise PreflightRefused(
                    _stuck(here, self._patience, enabled=enabled), code="power.stuck"
                )
            else:
                turn()
                cycles += 1
                if step is not None and not heard and cycles % _TOLD_AGAIN == 0:
                    if retold == _MOST_RETOLD:
                        raise NoAnswer(
                            f"the drive answers no controlword: told {retold + 1} times, it stays "
                            f"'{here}'",
                            code="power.unheard",
                        )
                    heard, retold = self._tell(step, turn), retold + 1

    def status(self, values: tuple[int, ...]) -> Status:
        """What the statusword says."""
        return cia402.status(values[self._at_status] & self._told)


class ProcedurePower:
    """Steps and conditions of the profile's [power]; `disable` and `fault` likewise."""

    def __init__(
        self, bus: Bus, profile: Profile, power: Power, describe: Callable[[], str]
    ) -> None:
        self._bus = bus
        self._describe = describe
        self._patience = profile.patience.enable
        self._profile = profile
        self._power = power
        into = profile.cycle.in_
        self._at_enabled = into.index(power.enabled.parameter) if profile.moves else 0
        fault = power.fault
        stopping = power.stopping
        self._at_fault = (
            into.index(fault.parameter) if fault is not None and fault.parameter in into else None
        )
        self._at_stopping = (
            into.index(stopping.parameter)
            if stopping is not None and stopping.parameter in into
            else None
        )
        self._known: dict[tuple[int, int, int], Status] = {}

    def peculiarities(self) -> tuple[str, ...]:
        """Nothing: a profile says what each bit means."""
        return ()

    def _holds(self, condition: Condition | None) -> bool:
        if condition is None:
            return False
        return condition.holds(
            self._bus.read(self._profile.parameters[condition.parameter].address)
        )

    def said(self) -> Said:
        """What its conditions say, with what the fault's parameter reads."""
        fault, on = self._power.fault, self._holds(self._power.enabled)
        stopping = self._holds(self._power.stopping)
        if fault is not None and self._holds(fault):
            code = self._bus.read(self._profile.parameters[fault.parameter].address)
            return Said(on or stopping, True, f"fault ({fault.parameter} {code:04X}h)")
        text = "stopping" if stopping else "enabled" if on else "disabled"
        return Said(on or stopping, False, text)

    def is_energised(self) -> bool:
        """Whether the drive says that it controls the axis."""
        return self._holds(self._power.enabled) or self._holds(self._power.stopping)

    def in_fault(self) -> bool:
        """Whether the drive reports a fault."""
        return self._holds(self._power.fault)

    def acknowledge(self) -> None:
        """The profile's reset steps; raises PreflightRefused where there are none."""
        if not self._power.reset:
            raise PreflightRefused(
                f"profile '{self._profile.name}' has no way to reset a fault: reset it at the "
                "drive",
                code="fault.no-reset",
            )
        self._perform(self._power.reset, "reset", lambda: self._pause(_POLL))

    def idle(self) -> Frame:
        """Zeros."""
        return [0] * len(self._profile.cycle.out)

    def enable(self, frame: Frame) -> None:
        """The profile's enable steps, then wait for its sign."""
        self._perform(self._power.enable, "enable", lambda: self._turn(frame))
        self._await(frame, enabled=True)

    def disable(self, frame: Frame) -> None:
        """The profile's disable steps, then wait for its sign."""
        self._perform(self._profile.disable, "disable", lambda: self._turn(frame))
        self._await(frame, enabled=False)

    def _await(self, frame: Frame, *, enabled: bool) -> None:
        waited = 0.0
        wanted = self._power.enabled
        while (self._holds(wanted) if enabled else self.is_energised()) is not enabled:
            if enabled and self.in_fault():
                raise DriveFault(
                    f"the drive went into fault while enabling: {self._describe()}",
                    code="power.fault",
                )
            if waited >= self._patience:
                told = self._told(enabled=enabled)
                raise PreflightRefused(
                    _stuck(self.said().text, self._patience, enabled=enabled, told=told),
                    code="power.stuck",
                )
            waited += self._turn(frame)

    def _told(self, *, enabled: bool) -> str:
        """What was written, and what its sign reads, for those who doubt the profile."""
        steps = self._power.enable if enabled else self._profile.disable
        written = ", ".join(
            f"{step.raw:X}h to '{step.write}' ({self._profile.parameters[step.write].address})"
            for step in steps
            if step.write is not None and step.raw is not None
        )
        sign = self._power.enabled
        there = self._bus.read(self._profile.parameters[sign.parameter].address)
        return (
            f"; written were {written}, and '{sign.parameter}' reads {there:X}h, of which the bits "
            f"{sign.mask & 0xFFFF:X}h {sign} when it is enabled: is that so, and in this order?"
        )

    def _perform(self, steps: tuple[Step, ...], what: str, wait: Callable[[], float]) -> None:
        perform(self._bus, self._profile, steps, what, wait)

    def _turn(self, frame: Frame) -> float:
        """The cycle feeds the drive's watchdog while brake and ramps take their time."""
        self._bus.exchange(tuple(frame))
        return self._bus.cycle

    def _pause(self, seconds: float) -> float:
        self._bus.wait(seconds)
        return seconds

    def status(self, values: tuple[int, ...]) -> Status:
        """What the parameters of the conditions say; there is no sign of a limit."""
        at, brakes = self._at_fault, self._at_stopping
        seen = (
            values[self._at_enabled],
            0 if at is None else values[at],
            0 if brakes is None else values[brakes],
        )
        status = self._known.get(seen)
        if status is None:
            fault, stopping = self._power.fault, self._power.stopping
            tripped = at is not None and fault is not None and fault.holds(seen[1])
            slows = brakes is not None and stopping is not None and stopping.holds(seen[2])
            on = self._power.enabled.holds(seen[0]) and not tripped and not slows
            status = Status(on, tripped, stopping=slows, limit=False, word=seen[0] & 0xFFFF)
            self._known[seen] = status
        return status


def _stuck(here: str, patience: float, *, enabled: bool, told: str = "") -> str:
    goal = "enabled" if enabled else "disabled"
    return (
        f"the drive does not become {goal}: it stays '{here}' for {patience:g} s{told} (STO or "
        "enable input open, or no mains? If it needs longer: [patience] enable in its profile)"
    )
