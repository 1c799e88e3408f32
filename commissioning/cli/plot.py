"""tworelay plot loci RUN."""

from __future__ import annotations

import io
from pathlib import Path

import click

from commissioning.cli.helping import HelpfulGroup
from commissioning.cli.options import verbose
from commissioning.cli.output import say, written
from commissioning.cli.quantity import POSITION, TORQUE
from profiles.errors import Refused, UsageError

__all__ = ["command"]

_FORMATS = (".svg", ".png", ".pdf")


@click.group("plot", cls=HelpfulGroup)
def command() -> None:
    """Pictures of a run."""


@command.command("loci")
@click.argument("run")
@click.option(
    "--amplitude", type=TORQUE, metavar="D",
    help="N.m or N, half of the relay's swing, of Figure 6. Default: the run's.",
)  # fmt: skip
@click.option(
    "--hysteresis", type=POSITION, metavar="E",
    help="rad or m, half-width, of Figure 5. Default: the run's.",
)  # fmt: skip
@click.option(
    "--output", metavar="F", help=".svg, .png or .pdf; default: loci.svg in the run's folder."
)
@verbose
def loci(run: str, amplitude: float | None, hysteresis: float | None, output: str | None) -> None:
    """The loci -1/N of relay and friction beside the identified plant, and name the file.

    Figures 4, 5 and 6 of Blaha's thesis: over the amplitude d without hysteresis, over d with one,
    and over the hysteresis.
    """
    import numpy as np

    from commissioning.journal import Journal
    from commissioning.report.figures import loci as draw
    from commissioning.report.quiet import quiet
    from commissioning.result.codec import printable
    from commissioning.runs import resolve
    from drivers.home import home

    with Journal(home(), reading=True) as journal:
        run_id, folder = resolve(journal, run)
    result = folder.result()
    if result.friction.coulomb is None or result.critical_point is None:
        raise Refused(
            f"run {run_id} measured no friction: there is no locus to draw", code="run.no-friction"
        )
    kind = Path(output or "loci.svg").suffix.lower()
    if kind not in _FORMATS:
        raise UsageError(f"--output {output}: must end with {', '.join(_FORMATS)}")
    picture = io.BytesIO()
    try:
        with np.errstate(divide="raise", invalid="raise", over="raise"), quiet():
            draw(printable(result), amplitude, hysteresis).savefig(
                picture, format=kind[1:], dpi=150
            )
    except (ArithmeticError, ValueError) as error:
        raise UsageError(f"run {run_id}: its numbers make no picture ({error})") from None
    say(str(written(picture.getvalue(), output, folder.path / "loci.svg", run_id)))
