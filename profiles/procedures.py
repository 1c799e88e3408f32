"""How a drive is reached, brought to power, set to a mode, watched and stored."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from profiles.strict import Strict
from profiles.transports import CycleFunction

__all__ = [
    "Condition",
    "Cycle",
    "LinkDefaults",
    "Mailbox",
    "Mode",
    "ModeCode",
    "Patience",
    "Power",
    "Step",
    "Store",
    "Watchdog",
    "writes_of",
]


class LinkDefaults(Strict):
    """How the drive is reached when the LINK does not say it."""

    node: Annotated[int, Field(ge=1, le=127)] | None = None
    unit: Annotated[int, Field(ge=0, le=255)] | None = None
    bitrate: int | None = None
    baudrate: int | None = None
    parity: Literal["N", "E", "O"] | None = None
    stopbits: Literal[1, 2] | None = None
    silence: Annotated[float, Field(ge=0)] = (
        0.0  # s between two frames, where more than the standard's
    )
    sharing: Literal["shared", "exclusive"] = "shared"
    cycle: Annotated[float, Field(gt=0)] = 0.005  # s
    service_timeout: Annotated[float, Field(gt=0)] = 0.5  # s, one request outside motion
    patience: Annotated[float, Field(ge=0)] = 5.0  # s, for a drive that says it is busy
    # parameters with the four numbers of the IP address for which it swaps the words of a value
    swapped_for: tuple[str, ...] = ()
    longest_answer: Annotated[float, Field(gt=0)] = 0.1  # s; later, none comes on a serial line


class Mode(StrEnum):
    """Operating mode by the names of IEC 61800-7-201 (CiA 402)."""

    TORQUE = "torque"
    POSITION = "position"


class Step(Strict):
    """One step of a procedure: write a raw value, or wait until bits of a parameter read so."""

    write: str | None = None
    raw: int | None = None
    until: str | None = None
    mask: int = -1
    equals: int | None = None
    within: Annotated[float, Field(gt=0)] = 1.0  # s

    @model_validator(mode="after")
    def _check(self) -> Self:
        writes = self.write is not None and self.raw is not None
        waits = self.until is not None and self.equals is not None
        if writes == waits:
            raise ValueError("a step is either { write, raw } or { until, mask, equals, within }")
        if self.equals is not None and self.equals & self.mask != self.equals:
            raise ValueError(
                f"mask {self.mask:#x} never leaves {self.equals:#x}: it can never read so"
            )
        return self


def writes_of(steps: Iterable[Step]) -> list[tuple[str, int]]:
    """Names and raw values that steps write, in their order."""
    return [
        (step.write, step.raw) for step in steps if step.write is not None and step.raw is not None
    ]


class Condition(Strict):
    """Bits of a parameter that read `equals`, a value `among`, or not `differs`."""

    parameter: str
    mask: int = -1
    equals: int | None = None
    among: tuple[int, ...] | None = None
    differs: int | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if sum(given is not None for given in (self.equals, self.among, self.differs)) != 1:
            raise ValueError("a condition has equals, among or differs, and only one of them")
        if self.among == ():
            raise ValueError("among is empty: nothing ever reads so")
        values = self.wanted or (self.differs,)
        for value in values:
            if value is not None and value & self.mask != value:
                raise ValueError(
                    f"mask {self.mask:#x} never leaves {value:#x}: it can never read so"
                )
        return self

    @property
    def wanted(self) -> tuple[int, ...]:
        """Values with which it holds; none where it is about the one with which it does not."""
        return self.among or (() if self.equals is None else (self.equals,))

    def holds(self, raw: int) -> bool:
        """Whether `raw` of the parameter fulfils it."""
        if self.differs is not None:
            return raw & self.mask != self.differs
        return raw & self.mask in self.wanted

    def __str__(self) -> str:
        """What it must read."""
        if self.differs is not None:
            return f"must not be {self.differs}"
        return f"must be {' or '.join(str(value) for value in self.wanted)}"


class Power(Strict):
    """How a drive without the CiA 402 state machine is energised, and how it says so.

    Its energy is taken by the profile's `disable`. `stopping`: it brakes, and takes no commands any
    more; without that sign only the position tells when it has come to rest. `fault` and `stopping`
    are watched in every cycle where their parameter is in the cycle. `enable` is empty only where
    there is no torque command: such a drive is never energised.
    """

    enable: tuple[Step, ...] = ()
    enabled: Condition
    stopping: Condition | None = None
    fault: Condition | None = None
    reset: tuple[Step, ...] = ()


class ModeCode(Strict):
    """How a mode is asked for: value for `mode_of_operation`, bit that says it is supported.

    `before` is written before the mode is enabled and put back after the experiment; it is all
    there is where a drive has no `mode_of_operation`.
    """

    code: int | None = None
    supported_bit: Annotated[int, Field(ge=0, le=31)] | None = None
    set_point: str
    before: tuple[Step, ...] = ()

    @model_validator(mode="after")
    def _check(self) -> Self:
        written = [step.write for step in self.before]
        if None in written:
            raise ValueError(
                "before are settings, which are put back: it writes, and waits for nothing (until "
                "belongs into [power] enable)"
            )
        twice = {name for name in written if written.count(name) > 1}
        if twice:
            raise ValueError(
                f"before writes '{min(map(str, twice))}' twice: a setting has one value (keys, one "
                "after the other, belong into [power] enable)"
            )
        return self


class Cycle(Strict):
    """What is exchanged every cycle.

    Modbus: one block of registers is written and one read (FC 23, or FC 16 or 6, then FC 3). Up to
    `gap` registers between two that are wanted are read along; further apart, each block is a
    transaction. CANopen: one RPDO out, SYNC, one TPDO in; each list is the PDO's mapping in order.
    """

    out: tuple[str, ...]
    in_: Annotated[tuple[str, ...], Field(alias="in")]
    function: CycleFunction
    gap: Annotated[int, Field(ge=0, le=100)] = 0
    rpdo: Annotated[int, Field(ge=1, le=4)] = 1
    tpdo: Annotated[int, Field(ge=1, le=4)] = 1


class Mailbox(Strict):
    """Registers through which parameters are reached by number.

    Fill in, execute, look, take the data.

    `request` takes `read_code` or `write_code`, and reads `done_code` when the data are there. Data
    have their length in bytes, and their low word first.
    """

    pnu: int
    sub: int
    elements: int
    request: int
    length: int
    data: int
    read_code: int
    write_code: int
    done_code: int
    within: Annotated[float, Field(gt=0)] = 0.5  # s


class Watchdog(Strict):
    """The drive-side watchdog of communication and how it is armed.

    `parameter` takes the time-out; `kind` says what feeds it: the cyclic command, any request, a
    heartbeat, or the remote frames of life guarding (CiA 301, 7.2.8.2.2).
    """

    kind: Literal["cycle", "traffic", "heartbeat", "guarding", "none"]
    parameter: str | None = None
    timeout: Annotated[float, Field(gt=0)] = 0.05  # s
    node: Annotated[int, Field(ge=1, le=127)] = 127  # whose heartbeat it is: ours
    guard_time: str | None = (
        None  # parameters of life guarding, for a drive without a heartbeat consumer
    )
    life_factor: str | None = None
    reaction: str | None = None  # parameter that says what the drive does
    reaction_raw: int | None = None

    @property
    def deadline(self) -> float:
        """Time-out of one cyclic answer, s.

        Three missed ones come before the drive's own time-out.
        """
        return self.timeout / 4


class Store(Strict):
    """How parameters are made non-volatile, and how often the memory takes it."""

    steps: tuple[Step, ...]
    endurance: Annotated[int, Field(gt=0)] = 100_000


class Patience(Strict):
    """How long a drive may take, s, to do what it was told.

    Real ones take milliseconds, or seconds.
    """

    boot: Annotated[float, Field(ge=0)] = (
        2.0  # until it answers at all, from when it is asked first
    )
    reset: Annotated[float, Field(gt=0)] = 2.0  # until a fault is gone after its acknowledgement
    mode: Annotated[float, Field(gt=0)] = 10.0  # until the mode that was asked for is displayed
    enable: Annotated[float, Field(gt=0)] = 5.0  # one transition of the state machine, brake too
    save: Annotated[float, Field(gt=0)] = 10.0  # until parameters are stored, and it listens again
