"""tworelay report RUN."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from commissioning.cli.helping import Helpful
from commissioning.cli.options import verbose
from commissioning.cli.output import document, say, written
from commissioning.cli.terminal import Screen
from profiles.errors import UsageError

if TYPE_CHECKING:
    from commissioning.records import History
    from commissioning.runs import RunFolder

__all__ = ["command", "say_report", "write_pdf", "write_report"]


@click.command("report", cls=Helpful)
@click.argument("run")
@click.option(
    "--output",
    metavar="F",
    help=".html or .pdf, '-': HTML on standard output; default: report.html in the run's folder.",
)
@click.option("--pdf", "pdf_target", metavar="F", help="A PDF to F; no browser is needed.")
@click.option("--paper", type=click.Choice(["a4", "letter"]), default="a4", show_default=True)
@click.option(
    "--language",
    type=click.Choice(["en", "de"]),
    help="Default: this computer's, where it is one of them.",
)
@verbose
def command(
    run: str, output: str | None, pdf_target: str | None, paper: str, language: str | None
) -> None:
    """Write the report of RUN as one self-contained file, and name it.

    The HTML makes no request: its pictures can be zoomed into where scripts run, and are printed
    as they are.
    """
    if output is not None and output.lower().endswith(".pdf"):
        if pdf_target is not None:
            raise UsageError("--output and --pdf both name a PDF")
        say(str(write_pdf(run, output, language, paper)))
        return
    _check_endings(output, pdf_target)
    if pdf_target is not None:
        say(str(write_pdf(run, pdf_target, language, paper)), err=output == "-")
    if output == "-":
        document(_html(run, language)[2])
    elif output is not None or pdf_target is None:
        say(str(write_report(run, output, language)))


def _check_endings(output: str | None, pdf_target: str | None) -> None:
    """Raise UsageError for an ending that is not ours."""
    for option, target, ending in (("--output", output, ".html"), ("--pdf", pdf_target, ".pdf")):
        endings = (".html", ".htm") if ending == ".html" else (".pdf",)
        if option == "--pdf" and target == "-":
            raise UsageError("--pdf -: a PDF is no text for a terminal; name a file")
        if target not in (None, "-") and not str(target).lower().endswith(endings):
            raise UsageError(f"{option} {target}: ends with {ending} or .pdf, as the file is one")


def say_report(run: str, screen: Screen) -> None:
    """Write the report at the end of a job, which is no less done where there is no room."""
    try:
        screen.say(f"report {write_report(run, None)}")
    except UsageError as error:
        screen.say(f"no report: {error}; 'tworelay report {run}' tries again")


def write_report(run: str, output: str | None, language: str | None = None) -> Path:
    """Render and write; returns the file."""
    run_id, folder, text = _html(run, language)
    return written(text.encode(), output, folder / "report.html", run_id)


def write_pdf(run: str, output: str, language: str | None, paper: str) -> Path:
    """Render and write; returns the file."""
    from commissioning.report.pdf import pdf_of
    from commissioning.result.language import usual

    run_id, folder, history = _run(run)
    text = pdf_of(folder.result(history), folder.samples(), history, language or usual(), paper)
    return written(text, output, folder.path / "report.pdf", run_id)


def _html(run: str, language: str | None) -> tuple[str, Path, str]:
    """Id, folder and text."""
    from commissioning.report.html import render
    from commissioning.result.language import usual

    run_id, folder, history = _run(run)
    text = render(folder.result(history), folder.samples(), history, language or usual())
    return run_id, folder.path, text


def _run(run: str) -> tuple[str, RunFolder, History]:
    from commissioning.journal import Journal
    from commissioning.runs import resolve
    from drivers.home import home

    with Journal(home(), reading=True) as journal:
        run_id, folder = resolve(journal, run)
        return run_id, folder, folder.history(journal, run_id)
