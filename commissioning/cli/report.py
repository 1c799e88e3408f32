"""tworelay report RUN."""

from __future__ import annotations

from pathlib import Path

import click

from commissioning.cli.options import verbose
from commissioning.cli.output import say
from commissioning.cli.terminal import Screen
from profiles.errors import UsageError
from profiles.files import replace

__all__ = ["command", "say_report", "write_report"]


@click.command("report")
@click.argument("run")
@click.option("--output", metavar="F", help="HTML file; default: in the run's folder.")
@verbose
def command(run: str, output: str | None) -> None:
    """Write the report of RUN as one self-contained HTML file, and name it."""
    say(str(write_report(run, output)))


def say_report(run: str, screen: Screen) -> None:
    """Write the report at the end of a job, whose outcome does not hang on there being room for it."""
    try:
        screen.say(f"report {write_report(run, None)}")
    except UsageError as error:
        screen.say(f"no report: {error}; 'tworelay report {run}' tries again")


def write_report(run: str, output: str | None) -> Path:
    """Render and write; returns the file."""
    from commissioning.journal import Journal
    from commissioning.report.html import render
    from commissioning.runs import resolve
    from drivers.home import home

    with Journal(home()) as journal:
        run_id, folder = resolve(journal, run)
        events = folder.history(journal, run_id)
    target = Path(output) if output else folder.path / "report.html"
    text = render(folder.result(), folder.samples(), events)
    try:
        if output:
            target.write_text(text, "utf-8")
        else:
            replace(target, text.encode())
    except OSError as error:
        raise UsageError(f"report {target}: cannot be written: {error.strerror}") from None
    return target
