"""The conversation with whoever sits at the terminal."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Container, Generator
from typing import Any
from unicodedata import normalize

import click

from commissioning.cli import output
from commissioning.cli.options import is_quiet, is_verbose
from commissioning.panel.feed import Panel
from commissioning.panel.lines import Lines
from commissioning.watching import Watcher
from profiles.errors import Refused
from profiles.plain import plain

__all__ = ["Screen"]


_FILE_WIDTH = 110


class Screen:
    """Where people read: standard output, or standard error when JSON takes the former.

    Attributes
    ----------
    verbose : theory and every phase are said, too
    agreed : word that somebody has typed already, for all that is asked by it
    """

    def __init__(self, json_target: str | None, *, yes: bool) -> None:
        self.to_stderr = json_target == "-"
        self.yes = yes
        self.verbose = is_verbose()
        self.agreed: str | None = None
        self._progress: Any = None
        self._panel: Panel | None = None
        self._told: set[str] = set()
        self._held: list[tuple[str, str | None]] = []  # said while the panel is drawn

    def say(self, text: str = "", style: str | None = None) -> None:
        """One line, folded between words on a terminal.

        `style` : a colour that repeats what the words mean
        """
        if self._panel is not None and self._panel.is_drawn:
            self._held.append((text, style))
            return
        if self._progress is None:
            output.say(text, err=self.to_stderr, style=style)
            return
        with output.giving_up(err=self.to_stderr):
            self._progress.console.print(plain(text), highlight=False, markup=False, soft_wrap=True)

    def tell(self, text: str) -> None:
        """One line of what happens, once; not where the result alone is asked for."""
        if not is_quiet() and text not in self._told:
            self._told.add(text)
            self.say(text)

    def console(self) -> Any:
        """A rich console on the same stream."""
        from rich.console import Console

        console = Console(stderr=self.to_stderr, highlight=False, soft_wrap=False)
        if not console.is_terminal:
            console.width = max(console.width, _FILE_WIDTH)  # nobody folds a file
        return console

    def confirm(self, question: str, word: str) -> bool:
        """Ask for `word` to be typed; raises Refused without a terminal."""
        if self.agreed is not None and word == self.agreed:
            return True
        if self._panel is not None:
            self.show_held()
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
    def watching(self, doing: str) -> Generator[Watcher]:
        """Somebody to whom a job shows how it goes on: a panel on a terminal, else a line a step.

        What is said meanwhile is said when the panel has gone.
        """
        console = self.console()
        drawn = console.is_terminal and not console.is_dumb_terminal and not console.no_color
        if not drawn or self.verbose or is_quiet():
            yield Watcher() if is_quiet() else Lines(self.say, detailed=self.verbose)
            return
        self._panel = Panel(doing, to_stderr=self.to_stderr)
        try:
            yield self._panel
        finally:
            self.show_held()
            if self._panel.has_died:
                self.say("the panel has ended by itself; the job went on without it")
            self._panel = None

    def show_held(self) -> None:
        """The panel goes, and what was said meanwhile comes."""
        if self._panel is not None:
            self._panel.close()
        held, self._held = self._held, []
        for text, style in held:
            self.say(text, style)

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
