"""The options of identify and commission, and what they ask for."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import wraps
from typing import Any

import click

from commissioning.cli import output
from commissioning.cli.options import verbose
from commissioning.cli.quantity import (
    DURATION,
    FREQUENCY,
    POSITION,
    SHARE,
    SPEED,
    TEMPERATURE,
    TORQUE,
    Measure,
    of_the_axis,
)
from commissioning.cli.targets import axis_from
from commissioning.desk import Options
from commissioning.result.readings import MethodName
from profiles.axis import Axis
from profiles.errors import UsageError

__all__ = ["CYCLE", "Job", "job_options", "share_from"]

CYCLE = Measure("time", low=0.0002, high=0.5)


_JOB_OPTIONS = [
    click.option("--profile", metavar="P", help="Drive profile: a built-in name or a file."),
    click.option(
        "--travel", type=POSITION, metavar="±X",
        help="Room about the present position: '±180 deg', '0,5 rev', '20mm'; rad or m without a "
        "unit.",
    ),
    click.option(
        "--max-torque", type=TORQUE, metavar="X", help="'0,5 Nm', '20 N'; N.m or N without a unit."
    ),
    click.option(
        "--max-speed", type=SPEED, metavar="X",
        help="'300 rpm', '20 mm/s'; rad/s or m/s without a unit.",
    ),
    click.option("--duration", type=DURATION, metavar="T", help="At most: '2 min', or s."),
    click.option(
        "--fraction", type=SHARE, default="85 %", show_default=True, metavar="P",
        help="Share of the friction to compensate; the offset is compensated whole.",
    ),
    click.option(
        "--method", type=click.Choice([name.value for name in MethodName]), default="auto",
        show_default=True,
        help="; ".join(f"{name}: {name.about}" for name in MethodName) + ".",
    ),
    click.option(
        "--precision", default="1%", show_default=True, metavar="P",
        help="Interval of the friction, either way, at which a measurement is long enough: a share "
        "or per cent; auto and output-error go on from 4 to at most 12 periods.",
    ),
    click.option(
        "--solver", type=click.Choice(["bracket", "thesis"]), default="bracket", show_default=True,
        help="Search for equal periods: bracketing secant, or the rules (4.21), (4.25) of the "
        "thesis.",
    ),
    click.option(
        "--repeat", type=click.IntRange(1, 50), default=1, show_default=True, metavar="N",
        help="Measure N times; the interval then holds what the results scatter by.",
    ),
    click.option(
        "--points", is_flag=True,
        help="Measure also the plant at -180 and -135 degrees, where travel, speed and torque "
        "allow it.",
    ),
    click.option(
        "--output-filter", type=FREQUENCY, metavar="W",
        help="'30 Hz', or rad/s: corner of a first-order filter in the drive's position signal, to "
        "be undone.",
    ),
    click.option("--cycle", type=CYCLE, metavar="T", help="Of the exchange: '4ms', or s."),
    click.option(
        "--motor-temperature", type=TEMPERATURE, metavar="T",
        help="°C, as somebody measured it, to be compared by later: for drives that tell none.",
    ),
    click.option(
        "--watchdog", type=Measure("time", low=0.005, high=5), metavar="T",
        help="Silence after which the drive stops by itself; default: the profile's.",
    ),
    click.option(
        "--without-watchdog", is_flag=True,
        help="Move a drive that would not notice a dead link; its watchdog, if any, is not "
        "proved. Emergency "
        "stop in hand.",
    ),
    click.option("--dry-run", is_flag=True, help="Show every write; write and move nothing."),
    click.option("--yes", is_flag=True, help="Confirm in advance."),
    click.option("--json", "json_target", metavar="F",
    help="Result as JSON to F, '-' for standard output."),
    click.option("--trace", metavar="F", help="Every frame to F: candump text, or pcap of Modbus."),
    verbose,
]  # fmt: skip


def share_from(text: str, name: str) -> float:
    """A share: '1%', '0,5 %' or 0.01; raises UsageError."""
    number = text.strip().replace(",", ".")
    try:
        value = float(number.removesuffix("%")) / (100 if number.endswith("%") else 1)
    except ValueError:
        value = math.nan
    if not 0 < value <= 1:
        raise UsageError(f"{name} {text}: a share of 0 to 1, or per cent up to 100 %, as in '1%'")
    return value


@dataclass(frozen=True, slots=True)
class Job:
    """What the user asks of a measurement, as the command line has it."""

    profile: str | None
    travel: float | None
    max_torque: float | None
    max_speed: float | None
    duration: float | None
    fraction: float
    method: str
    precision: str
    solver: str
    repeat: int
    points: bool
    output_filter: float | None
    cycle: float | None
    motor_temperature: float | None
    watchdog: float | None
    without_watchdog: bool
    dry_run: bool
    yes: bool
    json_target: str | None
    trace: str | None
    ask_each: bool = False

    @classmethod
    def of(cls, params: Mapping[str, Any]) -> Job:
        """From a command's parameters, others among them."""
        names = {field.name for field in fields(cls)} & set(params)
        return cls(**{name: params[name] for name in names})

    def options(self) -> Options:
        """The job's options; raises UsageError."""
        return Options(
            self.travel, self.max_torque, self.max_speed, self.duration, self.fraction,
            self.method, share_from(self.precision, "--precision"), self.solver, self.repeat,
            self.points, self.output_filter, self.cycle, self.without_watchdog, self.dry_run,
            ask_each=self.ask_each, motor_temperature=self.motor_temperature,
        )  # fmt: skip

    def axis(self, target: str) -> Axis:
        """TARGET with what is asked of it; raises UsageError."""
        axis = axis_from(target, self.profile)
        click.get_current_context().meta[output.AXIS] = axis
        is_linear = axis.mechanics.motion == "linear"
        for option in ("travel", "max_torque", "max_speed"):
            of_the_axis(getattr(self, option), f"--{option.replace('_', '-')}", linear=is_linear)
        if self.watchdog is None:
            return axis
        limits = axis.limits.model_copy(update={"watchdog": self.watchdog})
        return axis.model_copy(update={"limits": limits})


def job_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Options of identify and commission, which the command gets as `job`."""
    names = {field.name for field in fields(Job)}

    @wraps(function)
    def wrapped(*args: Any, **kwargs: Any) -> Any:
        others = {name: value for name, value in kwargs.items() if name not in names}
        return function(*args, job=Job.of(kwargs), **others)

    for option in reversed(_JOB_OPTIONS):
        wrapped = option(wrapped)
    return wrapped
