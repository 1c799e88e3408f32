"""What a drive is: the schema of a drive profile.

A profile is data: a TOML file that names parameters, where they are, in which unit, and the
procedures of the drive. It can name only parameters, never code. An unknown key is an error.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from profiles.address import FLOAT, MailboxAddress
from profiles.identity import IdentityMatch
from profiles.law import Compensation, LoopGains
from profiles.parameter import Parameter, Protection, Unit
from profiles.procedures import (
    Condition,
    Cycle,
    LinkDefaults,
    Mailbox,
    Mode,
    ModeCode,
    Patience,
    Power,
    Step,
    Store,
    Watchdog,
)
from profiles.strict import Strict
from profiles.transports import TRANSPORTS, TransportName

__all__ = ["Profile"]

_FACTORY_VALUES = 0x1011  # CiA 301: restore default parameters


_GAIN_UNITS = {
    "velocity_gain": Unit.RATED_TORQUE_PER_SPEED,
    "integral_time": Unit.SECOND,
    "position_gain": Unit.PER_SECOND,
}


def fault_code(text: str) -> int:
    """An error code as its manual has it: '7380h', '0x7380' or '29568'; raises ValueError."""
    digits = text.strip().lower()
    try:
        if digits.endswith("h"):
            return int(digits[:-1], 16)
        return int(digits, 0)
    except ValueError:
        raise ValueError(
            f"[faults] '{text}' is no error code: '7380h', '0x7380', '29568'"
        ) from None


class Profile(Strict):
    """A drive family: identity, parameters, procedures, limits.

    A drive whose [modes] has no torque is not moved: its friction is found in a recording, and
    written to it.
    """

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9.-]*$")]
    version: str
    title: str
    bus: TransportName
    status: Literal["virtual", "from documents", "tried on hardware"]
    sources: tuple[str, ...] = ()
    identity: IdentityMatch = IdentityMatch()
    link: LinkDefaults = LinkDefaults()
    state_machine: Literal["cia402", "procedure"] = "cia402"
    power: Power | None = None
    parameters: dict[str, Parameter]
    mailbox: Mailbox | None = None
    cycle: Cycle = Cycle.model_validate({"out": (), "in": (), "function": "fc16+3"})
    modes: dict[Mode, tuple[ModeCode, ...]] = {}  # the first one that the drive supports is taken
    stop: tuple[Step, ...] = ()  # brings the axis to rest; written without waiting for an answer
    disable: tuple[Step, ...] = ()  # takes the energy away; likewise
    stop_time: Annotated[float, Field(gt=0)] = 1.0  # s, from `stop` to rest, brake closed
    requires: tuple[Condition, ...] = ()  # looked at before anything is written
    exclusive: Step | None = None  # locks other masters out: written first, put back last
    # current: a second one of the torque; negative: of that direction, where it has its own
    limits: dict[
        Literal["torque", "torque_negative", "speed", "speed_negative", "current"], str
    ] = {}
    watchdog: Watchdog
    patience: Patience = Patience()
    store: Store | None = None
    compensation: Compensation
    own_estimates: dict[Literal["coulomb"], str] = {}  # what the drive itself has found, to compare
    conditions: dict[
        Literal["motor_temperature", "drive_temperature", "minutes_on"], str
    ] = {}  # what friction depends on beside wear: degC, min
    loops: LoopGains | None = None
    faults: dict[str, Annotated[str, Field(min_length=1, max_length=200)]] = {}

    def fault(self, code: int) -> str:
        """What the profile says of an error code, and what to do; '' where it says nothing."""
        return next((text for key, text in self.faults.items() if fault_code(key) == code), "")

    def __str__(self) -> str:
        return f"profile '{self.name}'"

    @property
    def moves(self) -> bool:
        """Whether torque can be commanded."""
        return bool(self.modes.get(Mode.TORQUE))

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        known = set(self.parameters)
        for key in self.faults:
            fault_code(key)
        if (self.state_machine == "procedure") != (self.power is not None):
            raise ValueError("[power] belongs to state_machine 'procedure', and only to that")
        if self.power is not None and self.moves != bool(self.power.enable):
            raise ValueError(
                "[power] enable belongs to a drive with a torque mode, and only to that"
            )
        wanted = {"torque_target", "position_actual"} if self.moves else set()
        if self.state_machine == "cia402":
            wanted |= {"controlword", "statusword", "mode_of_operation"}
            if any(code.code is None for codes in self.modes.values() for code in codes):
                raise ValueError("[modes] lacks a code: a CiA 402 drive is told its mode")
        if len(self.link.swapped_for) not in (0, 4):
            raise ValueError("[link] swapped_for names the four numbers of an IP address")
        for kind in ("torque", "speed"):
            if f"{kind}_negative" in self.limits and kind not in self.limits:
                raise ValueError(f"[limits] has {kind}_negative, and no {kind} of the other way")
        if missing := wanted - known:
            raise ValueError(f"[parameters] lacks {', '.join(sorted(missing))}")
        for where, name in self._references():
            if name not in known:
                raise ValueError(f"[{where}] names '{name}', which [parameters] does not have")
        for where, step in self._steps():
            if step.write is not None and step.raw is not None:
                low, high = self.parameters[step.write].range
                if not self.parameters[step.write].allows(step.raw):
                    raise ValueError(
                        f"[{where}] writes {step.raw} to '{step.write}', which takes {low}…{high}"
                    )
        return self

    @model_validator(mode="after")
    def _check_bus(self) -> Self:
        transport = TRANSPORTS[self.bus]
        for name, parameter in self.parameters.items():
            if not isinstance(parameter.address, transport.addresses):
                raise ValueError(
                    f"[parameters.{name}] has an address of another bus than '{self.bus}'"
                )
            if isinstance(parameter.address, MailboxAddress) and self.mailbox is None:
                raise ValueError(f"[parameters.{name}] is behind a mailbox: [mailbox] is missing")
        if not self.moves:
            return self
        status = "statusword" if self.power is None else self.power.enabled.parameter
        for name in (status, "position_actual"):
            if name not in self.cycle.in_:
                raise ValueError(f"[cycle] in lacks '{name}', which every cycle must see")
        for mode, codes in self.modes.items():
            for code in codes:
                if code.set_point not in self.cycle.out:
                    raise ValueError(f"[cycle] out lacks '{code.set_point}', set-point of {mode}")
        for name in (*self.cycle.out, *self.cycle.in_):
            address = self.parameters[name].address
            if isinstance(address, MailboxAddress) or address.type == FLOAT:
                raise ValueError(f"[cycle] has '{name}', which is no register with a whole number")
            if name in self.cycle.out and getattr(address, "bits", None) is not None:
                raise ValueError(f"[cycle] out has '{name}', which is only bits of a register")
        if self.cycle.function not in transport.cycles:
            raise ValueError(
                f"[cycle] function '{self.cycle.function}' does not fit bus '{self.bus}'"
            )
        return self

    @model_validator(mode="after")
    def _check_protection(self) -> Self:
        held = [
            name
            for name in (self.compensation.host, self.exclusive and self.exclusive.write)
            if name
        ]
        for name in held:
            if self.parameters[name].protection is not Protection.EXPERIMENT:
                raise ValueError(f"[parameters.{name}] must have protection 'experiment'")
        if self.exclusive is not None and self.exclusive.write is None:
            raise ValueError("[exclusive] is a write: { write, raw }")
        for name, parameter in self.parameters.items():
            index = getattr(parameter.address, "index", None)
            if index == _FACTORY_VALUES and parameter.protection is not Protection.READ:
                raise ValueError(
                    f"[parameters.{name}] is 1011h, which restores factory values and forgets the "
                    "motor: it must have protection 'read'"
                )
        for name in self.compensation.terms.values():
            if self.parameters[name].protection is not Protection.COMPENSATION:
                raise ValueError(f"[parameters.{name}] must have protection 'compensation'")
        for term, name in self.loops.terms.items() if self.loops else ():
            if self.parameters[name].protection is not Protection.GAIN:
                raise ValueError(f"[parameters.{name}] must have protection 'gain'")
            if self.parameters[name].unit is not _GAIN_UNITS[term]:
                raise ValueError(f"[parameters.{name}] must have unit '{_GAIN_UNITS[term]}'")
        return self

    def _steps(self) -> list[tuple[str, Step]]:
        """Every step of every procedure, with the section that it stands in."""
        found = [("stop", step) for step in self.stop] + [
            ("disable", step) for step in self.disable
        ]
        found += [("store", step) for step in (self.store.steps if self.store else ())]
        found += [("exclusive", self.exclusive)] if self.exclusive else []
        if self.power is not None:
            found += [("power", step) for step in (*self.power.enable, *self.power.reset)]
        for mode, codes in self.modes.items():
            found += [(f"modes.{mode}", step) for code in codes for step in code.before]
        return found

    def _references(self) -> list[tuple[str, str]]:
        found = [("cycle", name) for name in (*self.cycle.out, *self.cycle.in_)]
        for mode, codes in self.modes.items():
            found += [(f"modes.{mode}", code.set_point) for code in codes]
        found += [("compensation", name) for name in self.compensation.terms.values()]
        found += [("compensation", self.compensation.host)] if self.compensation.host else []
        found += [("limits", name) for name in self.limits.values()]
        found += [("link", name) for name in self.link.swapped_for]
        found += [("own_estimates", name) for name in self.own_estimates.values()]
        found += [("conditions", name) for name in self.conditions.values()]
        if self.loops is not None:
            found += [("loops", name) for name in self.loops.terms.values()]
            found += [("loops", self.loops.lag)] if self.loops.lag else []
        found += [(where, step.write or step.until or "") for where, step in self._steps()]
        found += [("requires", condition.parameter) for condition in self.requires]
        if self.power is not None:
            conditions = (self.power.enabled, self.power.stopping, self.power.fault)
            found += [("power", condition.parameter) for condition in conditions if condition]
        for mode, codes in self.modes.items():
            if any(code.code is not None for code in codes):
                found.append((f"modes.{mode}", "mode_of_operation"))
        watchdog = self.watchdog
        named = (watchdog.parameter, watchdog.reaction, watchdog.guard_time, watchdog.life_factor)
        found += [("watchdog", name) for name in named if name]
        return found
