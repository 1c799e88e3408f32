"""What commands share: the conversation with the user, and the options of a job."""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Callable, Container, Generator, Mapping
from dataclasses import dataclass, fields
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unicodedata import normalize

import click

from commissioning.cli import output
from commissioning.cli.options import verbose
from commissioning.desk import Desk, Options
from commissioning.errors import DoesNotHelp
from commissioning.interruption import Interruption
from commissioning.journal import Journal
from commissioning.result.readings import MethodName
from drivers.home import home
from drivers.link import axis_of
from profiles.axis import Axis, load_axis
from profiles.errors import ProfileError, Refused, TwoRelayError, UsageError
from profiles.plain import plain
from profiles.toml_files import parse_tree, read_text

if TYPE_CHECKING:
    from commissioning.result.document import RunResult

__all__ = [
    "Job",
    "Screen",
    "act_on",
    "at_desk",
    "axis_from",
    "check_json",
    "is_target",
    "job_options",
    "write_json",
]


_FILE_WIDTH = 110


class Screen:
    """Where people read: standard output, or standard error when JSON takes the former."""

    def __init__(self, json_target: str | None, *, yes: bool) -> None:
        self.to_stderr = json_target == "-"
        self.yes = yes
        self._progress: Any = None

    def say(self, text: str = "") -> None:
        """One line."""
        if self._progress is None:
            output.say(text, err=self.to_stderr)
            return
        with output.giving_up(err=self.to_stderr):
            self._progress.console.print(plain(text), highlight=False, markup=False, soft_wrap=True)

    def console(self) -> Any:
        """A rich console on the same stream."""
        from rich.console import Console

        console = Console(stderr=self.to_stderr, highlight=False, soft_wrap=False)
        if not console.is_terminal:
            console.width = max(console.width, _FILE_WIDTH)  # nobody folds a file
        return console

    def confirm(self, question: str, word: str) -> bool:
        """Ask for `word` to be typed; raises Refused without a terminal."""
        self.say(question)
        if self.yes:
            return True
        if not sys.stdin.isatty():
            raise Refused(
                "this needs a confirmation and there is no terminal: give --yes",
                code="refused.no-terminal",
            )
        with self.paused():
            answer: str = click.prompt(
                f"Type {plain(word)} to go on", default="", show_default=False, err=self.to_stderr
            )
        return normalize("NFC", answer.strip()) == normalize("NFC", word)

    @contextlib.contextmanager
    def working(self, text: str) -> Generator[None]:
        """Show that something goes on, and for how long, where there is a terminal."""
        console = self.console()
        if not console.is_terminal:
            yield
            return
        from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        columns = (
            SpinnerColumn(),
            TextColumn("{task.description}", markup=False),
            TimeElapsedColumn(),
        )
        with Progress(*columns, console=console, refresh_per_second=4, transient=True) as progress:
            progress.add_task(plain(text))
            self._progress = progress
            try:
                yield
            finally:
                self._progress = None

    @contextlib.contextmanager
    def counting(self, text: str, total: int) -> Generator[Callable[[int], None]]:
        """Show how far a row of steps is, where there is a terminal.

        The value is told each step.
        """
        console = self.console()
        if not console.is_terminal:
            yield lambda step: None
            return
        from rich.progress import Progress

        with Progress(console=console, refresh_per_second=4, transient=True) as progress:
            task = progress.add_task(text, total=total)
            yield lambda step: progress.advance(task)

    @contextlib.contextmanager
    def paused(self) -> Generator[None]:
        """Without the moving line, for a question."""
        progress = self._progress
        if progress is None:
            yield
            return
        progress.stop()
        self._progress = None
        try:
            yield
        finally:
            self._progress = progress
            progress.start()

    def table(
        self,
        title: str,
        columns: list[str],
        rows: list[list[str]],
        *,
        of_words: bool = False,
        ends: Container[int] = (),
    ) -> None:
        """A table; `of_words`: and not of numbers. `ends`: rows with a line beneath."""
        from rich.table import Table

        table = Table(title=plain(title), title_justify="left", title_style="bold")
        for n, column in enumerate(columns):
            justify = "left" if n == 0 or of_words else "right"
            table.add_column(plain(column), justify=justify, no_wrap=n == 0, overflow="fold")  # type: ignore[arg-type]
        for n, row in enumerate(rows):
            table.add_row(*map(plain, row), end_section=n in ends)
        with output.giving_up(err=self.to_stderr):
            self.console().print(table, markup=False)


@contextlib.contextmanager
def at_desk(
    screen: Screen, trace: Callable[..., None] | None = None, *, to_stop: bool = False
) -> Generator[Desk]:
    """Journal open, signals caught; `to_stop`: without the journal, whatever that is like."""
    with _journal(to_stop=to_stop) as journal, Interruption() as interruption:
        yield Desk(journal, interruption, screen.say, screen.confirm, trace)


def _journal(*, to_stop: bool) -> Journal:
    return Journal.empty() if to_stop else Journal(home())


def is_target(text: str) -> bool:
    """Whether a text is a TARGET, a LINK or an axis file, and not a RUN."""
    return "://" in text or text.startswith("modbus-rtu:") or text.endswith(".toml")


def axis_from(target: str, profile: str | None) -> Axis:
    """TARGET, a LINK or an axis file, as an axis."""
    if "://" in target or target.startswith("modbus-rtu:"):
        axis = axis_of(target)
    elif target.endswith(".toml"):
        axis = _axis_of_file(Path(target))
        if axis.link is None:
            raise UsageError(f'{target}: has no link; add link = "modbus-tcp://…"')
    else:
        raise UsageError(
            f"'{target:.80}' is no link and no axis file; a link begins with virtual://, "
            "modbus-tcp://, modbus-rtu: or canopen://, an axis file ends with .toml"
        )
    return axis.model_copy(update={"profile": profile}) if profile else axis


def _axis_of_file(path: Path) -> Axis:
    """An axis file; one that is a fleet file is told so."""
    try:
        return load_axis(path)
    except ProfileError:
        if not _is_fleet(path):
            raise
    raise UsageError(
        f"{path}: is a fleet file, and no axis file", hint=f"'tworelay fleet check {path}'"
    )


def _is_fleet(path: Path) -> bool:
    try:
        return "axes" in parse_tree(read_text(path), str(path))
    except ProfileError:
        return False


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

    @classmethod
    def of(cls, params: Mapping[str, Any]) -> Job:
        """From a command's parameters, others among them."""
        return cls(**{field.name: params[field.name] for field in fields(cls)})

    def options(self) -> Options:
        """The job's options; raises UsageError."""
        return Options(
            travel_from(self.travel), self.max_torque, self.max_speed, self.duration, self.fraction,
            self.method, share_from(self.precision, "--precision"), self.solver, self.repeat,
            self.points, self.output_filter, self.cycle, self.without_watchdog, self.dry_run,
            motor_temperature=self.motor_temperature,
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


@contextlib.contextmanager
def act_on(run: str, desk: Desk, screen: Screen, json_target: str | None) -> Generator[None]:
    """An act on `run` that ends early writes its JSON, too, and says what is true then."""
    from commissioning.cli import show
    from commissioning.ending import of_failed

    try:
        yield
    except TwoRelayError as error:
        if error.exit_code >= 3:
            with contextlib.suppress(TwoRelayError):  # the first error is the one to be told
                result = of_failed(desk, run, error)
                write_json(result, json_target)
                if isinstance(error, DoesNotHelp):
                    show.verification(result, screen)
                show.ending(result, screen)
        raise


def check_json(target: str | None, option: str = "--json") -> None:
    """See before anything is done that the result can be written; raises UsageError."""
    if target is None or target == "-":
        return
    path = Path(target)
    if path.is_dir() or not path.absolute().parent.is_dir():
        raise UsageError(
            f"{option} {target}: cannot be written: no such folder, or a folder itself"
        )


def write_json(result: RunResult, target: str | None) -> None:
    """Result as JSON to a file or standard output.

    Where it cannot be written, the job is no less done.
    """
    click.get_current_context().meta[output.RESULT] = result
    if target is None:
        return
    from commissioning.result.codec import text_of

    text = text_of(result)
    if target == "-":
        output.document(text)
        return
    try:
        Path(target).write_text(text, "utf-8")
    except OSError as error:
        kept = f"; run {result.run} keeps the result" if result.run else ""
        output.say(
            f"tworelay: --json {target}: cannot be written: {error.strerror}{kept}", err=True
        )
