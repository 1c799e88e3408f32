"""A fleet run on the terminal: its table, as it goes on, and the questions in between."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator
from dataclasses import replace
from textwrap import wrap
from typing import Any
from unicodedata import normalize

from commissioning.cli.fleet.keyboard import Keyboard
from commissioning.cli.output import document, giving_up
from commissioning.cli.terminal import Screen
from commissioning.fleet.people import Answer, Ask
from commissioning.result.fleet import FAILED, FleetAxis, FleetResult, JobState
from commissioning.result.words import number, remaining
from profiles.plain import plain

__all__ = ["FleetScreen", "final_table", "rows", "summary"]

_STYLES = {
    JobState.DONE: "green", JobState.STARTED: "bold", JobState.GRANTED: "bold",
    JobState.BLOCKED: "yellow",
    **dict.fromkeys(FAILED, "red"),
}  # fmt: skip
_QUIET = JobState.PLANNED, JobState.WAITING, JobState.GRANTED  # told by the table alone
_LONGEST = 160  # characters of a reason
_WIDEST = 30  # characters of a column that is never cut
_AROUND = 6  # lines of a screen that a table needs beside its rows
_TRIES = 3  # at a word that is to be typed
_COLUMNS = "axis", "state", "step", "friction", "less error", "what"


def rows(result: FleetResult) -> list[list[str]]:
    """One row an axis: name, state, step, friction with its interval, gain, what happens."""
    return [
        [one.name, str(one.state), _step(one), _friction(one), _gain(one), _what(one)]
        for one in result.axes
    ]


def _step(one: FleetAxis) -> str:
    return f"{one.step} of {one.steps}" if one.steps and one.state is JobState.STARTED else ""


def _friction(one: FleetAxis) -> str:
    found = one.outcome.coulomb if one.outcome else None
    return f"{number(found.value, found.unit)} ± {100 * found.half_width:.2g} %" if found else ""


def _gain(one: FleetAxis) -> str:
    percent = one.outcome.percent if one.outcome else None
    return "" if percent is None else f"{percent:.0f} %"


def _what(one: FleetAxis) -> str:
    return one.what if one.doing else _brief(one.what)


def summary(result: FleetResult) -> str:
    """How many are in which state, and how long it takes."""
    counts = [f"{count} {state}" for state in JobState if (count := result.count(state))]
    left = "" if result.left is None else f"; {remaining(result.left)} left, about"
    return f"{result.state}: {', '.join(counts)}{left}"


class FleetScreen:
    """Whoever sits at the terminal of a fleet run.

    `watchers` : get every picture of the run, too
    """

    def __init__(self, screen: Screen, *watchers: Callable[[FleetResult], None]) -> None:
        self._screen = screen
        self._watchers = watchers
        self._live: Any = None
        self._word = ""  # that is asked for
        self._said: dict[str, str] = {}

    @contextlib.contextmanager
    def living(self) -> Generator[None]:
        """With a table that moves, where there is a terminal."""
        console = self._screen.console()
        if not console.is_terminal:
            yield
            return
        from rich.live import Live

        with Live(console=console, auto_refresh=False, transient=True) as live:
            self._live = live
            try:
                yield
            finally:
                self._live = None

    def tell(self, text: str) -> None:
        """One line; above the question, if there is one."""
        if self._live is None or self._word:
            if self._word:
                self._screen.say()
            self._screen.say(text)
            self._prompt()
            return
        with giving_up(err=self._screen.to_stderr):
            self._live.console.print(plain(text), highlight=False, markup=False)

    def show(self, result: FleetResult) -> None:
        """The run as it is now: a table that moves, or a line for each axis that has ended."""
        for watcher in self._watchers:
            watcher(result)
        now = {one.name: str(one.state) for one in result.axes}
        before, self._said = self._said or now, now
        if self._live is None or self._word:  # the table waits for the answer
            for one in result.axes:
                if before[one.name] != one.state and one.state not in _QUIET:
                    self.tell(_line(one))
            return
        console = self._live.console
        shown = _most_telling(result, console.height - _AROUND)
        with giving_up(err=self._screen.to_stderr):
            self._live.update(_table(shown, result, within=console.width), refresh=True)

    def ask(self, text: str, word: str) -> Ask:
        """Ask beside what goes on."""
        if self._live is not None:
            self._live.update("", refresh=True)
            self._live.stop()
        width = self._screen.console().width
        for line in text.splitlines():
            indent = " " * (len(line) - len(line.lstrip()) + 2)
            for part in wrap(line, width, subsequent_indent=indent) or [""]:
                self._screen.say(part)
        keyboard = Keyboard()
        self._word = word
        self._prompt()
        tries = _TRIES

        def answered() -> Answer | None:
            nonlocal tries
            line = keyboard.line()
            if line is None:
                return None
            typed = normalize("NFC", line.strip())
            if line and typed and typed != normalize("NFC", word) and tries > 1:
                tries -= 1
                self._screen.say(f"that is not {word}; Enter alone says no")
                self._prompt()
                return None
            self.withdraw()
            if not line:
                return Answer.NOBODY
            return Answer.YES if typed == normalize("NFC", word) else Answer.NO

        return answered

    def withdraw(self) -> None:
        """The question needs no answer any more."""
        self._word = ""
        if self._live is not None:
            self._live.start()

    def _prompt(self) -> None:
        if self._word:
            document(f"Type {plain(self._word)} to go on: ", err=self._screen.to_stderr)


def _line(one: FleetAxis) -> str:
    """What has become of an axis, where there is no table."""
    why = "" if one.doing else _brief(one.what)
    parts = [_friction(one), _gain(one) and f"{_gain(one)} less error", why]
    return f"{one.name}: {one.state}  {'; '.join(filter(None, parts))}".rstrip()


def _brief(text: str) -> str:
    """As much of a text as a table bears; the whole is in the pages."""
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"


def _most_telling(result: FleetResult, room: int) -> FleetResult:
    """As many axes as there is room for: what is under way, what failed, what is still to come."""
    if len(result.axes) <= room:
        return result
    ranked = sorted(range(len(result.axes)), key=lambda n: _rank(result.axes[n].state))
    shown = sorted(ranked[: max(room, 1)])
    return replace(result, axes=tuple(result.axes[n] for n in shown))


def _rank(state: JobState) -> int:
    if state in (JobState.STARTED, JobState.GRANTED):
        return 0
    if state in FAILED:
        return 1
    return 2 if state in _QUIET else 3


def _table(result: FleetResult, run: FleetResult, *, within: int | None = None) -> Any:
    """Some axes of a run; `within`: so many columns, in which each axis has one line."""
    from rich.table import Table

    left_out = len(run.axes) - len(result.axes)
    more = f" ({left_out} axes are not shown)" if left_out else ""
    title = plain(f"{run.name}: {summary(run)}{more}")
    table = Table(title=title, title_justify="left", title_style="bold")
    cells = [list(map(plain, row)) for row in rows(result)]
    widths = [
        min(max((len(row[n]) for row in [*cells, list(_COLUMNS)]), default=0), _WIDEST)
        for n in range(len(_COLUMNS) - 1)
    ]
    last = len(_COLUMNS) - 1
    for n, column in enumerate(_COLUMNS):
        table.add_column(
            column, no_wrap=n < last, overflow="fold" if n == last else "ellipsis",
            width=widths[n] if n < last else None,
        )  # fmt: skip
    if within is not None:
        room = max(within - sum(widths) - 3 * len(_COLUMNS) - 1, 1)
        for row in cells:
            row[last] = row[last] if len(row[last]) <= room else f"{row[last][: room - 1]}…"
    for one, row in zip(result.axes, cells, strict=True):
        table.add_row(*row, style=_STYLES.get(one.state))
    return table


def final_table(result: FleetResult, screen: Screen) -> None:
    """The run as it has ended."""
    with giving_up(err=screen.to_stderr):
        screen.console().print(_table(result, result), markup=False)
