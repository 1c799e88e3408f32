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
from commissioning.cli.targets import axis_from
from commissioning.desk import Options
from commissioning.result.readings import MethodName
from profiles.axis import Axis
from profiles.errors import UsageError

__all__ = ["Finite", "Job", "job_options", "share_from", "travel_from"]


class Finite(click.FloatRange):
    """A number in a range; neither nan nor infinite."""

    def convert(self, value: Any, param: Any, ctx: Any) -> float:
        """Text to number."""
        number: float = super().convert(value, param, ctx)
        if not abs(number) < float("inf"):
            self.fail(f"{value} is no finite number.", param, ctx)
        return number


_JOB_OPTIONS = [
    click.option("--profile", metavar="P", help="Drive profile: a built-in name or a file."),
    click.option("--travel", metavar="±X", help="Room about the present position, rad or m."),
    click.option("--max-torque", type=Finite(0, min_open=True), help="N.m or N."),
    click.option("--max-speed", type=Finite(0, min_open=True), help="rad/s or m/s."),
    click.option("--duration", type=Finite(0, min_open=True), help="s, at most."),
    click.option(
        "--fraction", type=Finite(0, 1), default=0.85, show_default=True,
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
        "--output-filter", type=Finite(0, min_open=True), metavar="W",
        help="rad/s: corner of a first-order filter in the drive's position signal, to be undone.",
    ),
    click.option("--cycle", type=Finite(0.0002, 0.5), help="s, of the exchange."),
    click.option(
        "--motor-temperature", type=Finite(-100, 300), metavar="T",
        help="°C, as somebody measured it, to be compared by later: for drives that tell none.",
    ),
    click.option(
        "--watchdog", type=Finite(0.005, 5),
        help="s of silence after which the drive stops by itself; default: the profile's.",
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
    travel: str | None
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
            travel_from(self.travel), self.max_torque, self.max_speed, self.duration, self.fraction,
            self.method, share_from(self.precision, "--precision"), self.solver, self.repeat,
            self.points, self.output_filter, self.cycle, self.without_watchdog, self.dry_run,
            ask_each=self.ask_each, motor_temperature=self.motor_temperature,
        )  # fmt: skip

    def axis(self, target: str) -> Axis:
        """TARGET with what is asked of it; raises UsageError."""
        axis = axis_from(target, self.profile)
        click.get_current_context().meta[output.AXIS] = axis
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


def travel_from(text: str | None) -> float | None:
    """±X as the user gives it, rad or m; raises UsageError."""
    if text is None:
        return None
    try:
        travel = float(text.lstrip("±+"))
    except ValueError:
        travel = -1.0
    if not 0 < travel < float("inf"):
        raise UsageError(
            f"--travel {text}: must be a positive number of rad or m, as in --travel ±0.5"
        )
    return travel
