"""The report of a run: one HTML file that needs nothing else."""

from __future__ import annotations

import time
from collections.abc import Iterator

import markupsafe
import numpy as np

from commissioning.records import History
from commissioning.report import figures
from commissioning.report.interactive import live
from commissioning.report.quiet import quiet
from commissioning.report.templates import template
from commissioning.report.words_of import foot_of, proofs_of
from commissioning.result import words
from commissioning.result.codec import printable
from commissioning.result.document import RunResult
from commissioning.result.found import POINTS, QUANTITIES
from commissioning.result.language import language as spoken
from commissioning.result.language import speaking
from commissioning.result.worth import LOOPS
from commissioning.samples import Samples
from profiles.errors import UsageError
from profiles.plain import plain

__all__ = ["render"]

_POINTS = {
    "naive": "naive: what a relay autotuner concludes",
    "hysteresis": "with the relay's hysteresis only",
    "corrected": "with hysteresis and friction",
    "measured": "the same period, another amplitude",
    "at_180": "where the phase is −180°",
    "at_135": "where the phase is −135°",
}
_QUANTITIES = {
    "coulomb": "Coulomb friction, mean of both directions",
    "offset": "Offset: load, and half of what the directions differ",
    "viscous": "Viscous friction",
    "inertia": "Inertia",
    "dead_time": "Dead time",
}


def render(
    result: RunResult, samples: Samples | None, history: History, language: str = "en"
) -> str:
    """HTML text of the report; everything in it that is not ours is escaped.

    Raises UsageError when its numbers make no picture.
    """
    result = printable(result)
    try:
        errors = np.errstate(divide="raise", invalid="raise", over="raise")
        with errors, quiet(), speaking(language):
            return _render(result, samples, history)
    except (LookupError, ValueError, ArithmeticError) as error:
        raise UsageError(
            f"run {result.run}: its numbers make no report ({type(error).__name__}: {error})"
        ) from None


def _pictures(result: RunResult, samples: Samples | None) -> Iterator[tuple[str, str]]:
    """Name and SVG of what there is to be seen."""
    curves = {} if samples is None else samples.curves
    if samples is not None and len(samples) > 1:
        yield "overview", figures.svg(figures.overview(samples, result.units))
        if figures.oscillations(result):
            yield "tests", figures.tests_over_time(samples, result)
            yield "phase_plane", figures.phase_plane(samples, result)
    if figures.narrows(result):
        yield "progress", figures.progress(result)
    if result.friction.curve is not None:
        yield "curve", figures.friction_curve(result)
    if figures.oscillations(result) and result.critical_point and result.friction.coulomb:
        yield "nyquist", figures.nyquist(result)
        yield "loci", figures.loci_svg(result)
    if result.verification is not None:
        followed = figures.following(result.verification, curves)
        if followed is not None:
            yield "verification", figures.svg(followed)
    for loop in LOOPS:
        if any(one.gains for one in result.of_loop(loop)):
            yield f"tuning_{loop}", figures.tuning(result, loop, curves)


def _render(result: RunResult, samples: Samples | None, history: History) -> str:
    stages: list[tuple[float, str]] = []
    if samples is not None and len(samples) > 1:
        samples.phases = [p._replace(text=plain(p.text)) for p in samples.phases]
        stages = figures.stages(samples)
    created = time.strftime("%Y-%m-%d %H:%M %z", time.localtime(history.run.created))
    shown = live(result, samples)
    coulomb = result.friction.coulomb
    return template("report.html.j2").render(
        r=result,
        history=history,
        created=created,
        stages=stages,
        pictures={
            name: markupsafe.Markup(svg)  # noqa: S704
            for name, svg in _pictures(result, samples)
            if svg
        },
        quantities=[(_QUANTITIES[key], result.friction.quantity(key)) for key in QUANTITIES]
        + ([("of it a lag of the torque", lag)] if (lag := result.friction.lag) else []),
        points=[
            (_POINTS[key], point)
            for key in POINTS
            if result.critical_point and (point := result.critical_point.point(key))
        ],
        loops=[(loop, words.LOOP_TITLES[loop], result.of_loop(loop)) for loop in LOOPS],
        words=words,
        language=spoken(),
        foot=foot_of(result, created),
        as_of=result.ended or created,
        counted=words.counted(coulomb) if coulomb else "",
        proofs=proofs_of(samples),
        live=shown,
        live_scripts=[markupsafe.Markup(s) for s in shown.scripts] if shown else [],  # noqa: S704
        live_pictures=[(t, markupsafe.Markup(div)) for t, div in shown.pictures] if shown else [],  # noqa: S704
    )
