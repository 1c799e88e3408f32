"""tworelay plot loci RUN."""

from __future__ import annotations

import io
from pathlib import Path

import click

from commissioning.cli.options import verbose
from commissioning.cli.output import say
from commissioning.cli.terminal import Finite
from profiles.errors import Refused, UsageError
from profiles.files import replace
from profiles.plain import plain_tree

__all__ = ["command"]

_FORMATS = (".svg", ".png", ".pdf")


@click.group("plot")
def command() -> None:
    """Pictures of a run."""


@command.command("loci")
@click.argument("run")
@click.option(
    "--amplitude", type=Finite(0, min_open=True), metavar="D",
    help="N.m or N, half of the relay's swing, of Figure 6. Default: the run's.",
)  # fmt: skip
@click.option(
    "--hysteresis", type=Finite(0, min_open=True), metavar="E",
    help="rad or m, half-width, of Figure 5. Default: the run's.",
)  # fmt: skip
@click.option(
    "--output", metavar="F", help=".svg, .png or .pdf; default: loci.svg in the run's folder."
)
@verbose
def loci(run: str, amplitude: float | None, hysteresis: float | None, output: str | None) -> None:
    """The loci -1/N of relay and friction beside the identified plant, and name the file.

    Figures 4, 5 and 6 of Blaha's thesis: over the amplitude d without hysteresis, over d with one, and
    over the hysteresis.
    """
    import numpy as np

    from commissioning.journal import Journal
    from commissioning.report.figures import loci as draw
    from commissioning.report.quiet import quiet
    from commissioning.runs import resolve
    from drivers.home import home

    with Journal(home()) as journal:
        run_id, folder = resolve(journal, run)
    result = folder.result()
    coulomb = result["friction"].get("coulomb") or {}
    if coulomb.get("value") is None or not result.get("critical_point"):
        raise Refused(f"run {run_id} measured no friction: there is no locus to draw")
    target = Path(output) if output else folder.path / "loci.svg"
    if target.suffix not in _FORMATS:
        raise UsageError(f"--output {target}: must end with {', '.join(_FORMATS)}")
    try:
        with np.errstate(divide="raise", invalid="raise", over="raise"), quiet():
            picture = io.BytesIO()
            kind = target.suffix.lower()[1:]
            draw(plain_tree(result), amplitude, hysteresis).savefig(picture, format=kind, dpi=150)
        if output:
            target.write_bytes(picture.getvalue())
        else:
            replace(target, picture.getvalue())
    except OSError as error:
        raise UsageError(f"{target}: cannot be written: {error.strerror}") from None
    except (KeyError, TypeError, IndexError, ArithmeticError, ValueError) as error:
        raise UsageError(
            f"run {run_id}: lacks what the picture needs ({type(error).__name__}: {error})"
        ) from None
    say(str(target))
