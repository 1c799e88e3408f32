"""The report of a run: one HTML file that needs nothing else."""

from __future__ import annotations

import time
from importlib.resources import files
from typing import Any

from commissioning.report.quiet import quiet
from commissioning.report.words import GAINS, duration, host_law
from commissioning.runs import Samples
from profiles.errors import UsageError
from profiles.plain import plain, plain_tree

__all__ = ["render"]


def render(result: dict[str, Any], samples: Samples | None, journal: dict[str, Any]) -> str:
    """HTML text of the report; everything in it that is not ours is escaped.

    Raises UsageError when the result is not what tworelay writes.
    """
    import jinja2
    import numpy as np

    result, journal = plain_tree(result), plain_tree(journal)
    if samples is not None:
        samples = Samples(samples.columns, [(at, plain(text)) for at, text in samples.phases])
    try:
        with np.errstate(divide="raise", invalid="raise", over="raise"), quiet():
            return _render(result, samples, journal)
    except (jinja2.UndefinedError, LookupError, TypeError, ValueError, ArithmeticError) as error:
        raise UsageError(
            f"run {result.get('run')}: its run.json is damaged or not ours "
            f"({type(error).__name__}: {error})"
        ) from None


def _render(result: dict[str, Any], samples: Samples | None, journal: dict[str, Any]) -> str:
    import jinja2
    import markupsafe

    from commissioning.report import figures

    pictures: dict[str, markupsafe.Markup] = {}
    stages: list[tuple[float, str]] = []
    if samples is not None and len(samples) > 1:
        pictures["overview"] = markupsafe.Markup(figures.overview(samples, result["units"]))  # noqa: S704
        stages = figures.stages(samples)
        if result["methods"]:
            pictures["tests"] = markupsafe.Markup(figures.tests_over_time(samples, result))  # noqa: S704
            pictures["phase_plane"] = markupsafe.Markup(figures.phase_plane(samples, result))  # noqa: S704
            if "modulating" in result["methods"]:
                pictures["curve"] = markupsafe.Markup(figures.friction_curve(result))  # noqa: S704
            pictures["nyquist"] = markupsafe.Markup(figures.nyquist(result))  # noqa: S704
            pictures["loci"] = markupsafe.Markup(figures.loci_svg(result))  # noqa: S704
    if result.get("verification"):
        pictures["verification"] = markupsafe.Markup(figures.following(result))  # noqa: S704
    for loop in dict.fromkeys(item["loop"] for item in result["tuning"]):
        pictures[f"tuning_{loop}"] = markupsafe.Markup(figures.tuning(result, loop))  # noqa: S704
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["si"] = _si
    environment.filters["seconds"] = duration
    environment.filters["host_law"] = host_law
    environment.filters["brief"] = lambda value: "–" if value is None else f"{value:.3g}"
    environment.tests["search"] = lambda text, part: part in text
    environment.globals["gain_names"] = GAINS
    template = environment.from_string(
        (files("commissioning.report") / "report.html.j2").read_text("utf-8")
    )
    created = time.strftime("%Y-%m-%d %H:%M", time.localtime(journal["run"]["created"]))
    return template.render(
        r=result, pictures=pictures, stages=stages, journal=journal, created=created
    )


def _si(value: float | None, unit: str = "") -> str:
    """Four digits and the unit, or a dash."""
    if value is None:
        return "–"
    return f"{value:.4g} {unit.replace('.', '·').replace('kg·m2', 'kg·m²')}".strip()
