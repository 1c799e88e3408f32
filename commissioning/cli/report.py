"""tworelay report RUN."""

from __future__ import annotations

from pathlib import Path

import click

from commissioning.cli.options import verbose
from commissioning.cli.output import say, written
from commissioning.cli.terminal import Screen
from profiles.errors import UsageError

__all__ = ["command", "say_report", "write_report"]


@click.command("report")
@click.argument("run")
@click.option("--output", metavar="F", help="HTML file; default: in the run's folder.")
@verbose
def command(run: str, output: str | None) -> None:
    """Write the report of RUN as one self-contained HTML file, and name it."""
    say(str(write_report(run, output)))


def say_report(run: str, screen: Screen) -> None:
    """Write the report at the end of a job, which is no less done where there is no room."""
    try:
        screen.say(f"report {write_report(run, None)}")
    except UsageError as error:
        screen.say(f"no report: {error}; 'tworelay report {run}' tries again")


def write_report(run: str, output: str | None, language: str | None = None) -> Path:
    """Render and write; returns the file."""
    from commissioning.journal import Journal
    from commissioning.report.html import render
    from commissioning.result.language import usual
    from commissioning.runs import resolve
    from drivers.home import home

    with Journal(home(), reading=True) as journal:
        run_id, folder = resolve(journal, run)
        history = folder.history(journal, run_id)
    text = render(folder.result(history), folder.samples(), history, language or usual())
    return written(text.encode(), output, folder.path / "report.html", run_id)
