"""Pictures that can be looked into: zoom, pan and values under the pointer, without a server.

What they are made of lies in the page: bokeh's own script, and the columns as 32-bit numbers.
"""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from commissioning.report.plant import response_of
from commissioning.report.reduced import reduced, velocity_of
from commissioning.result.document import RunResult
from commissioning.result.language import said
from commissioning.result.words import unit
from commissioning.samples import Array, Samples

__all__ = ["Live", "live"]

BLUE, ORANGE, GREY, GREEN = "#2f7ed8", "#d9730d", "#808080", "#2e9e44"
_TOOLS = "pan,box_zoom,wheel_zoom,xwheel_zoom,undo,reset,save"
_MOST = 20_000  # samples of a column: more are reduced to the extremes of each stretch
_HEIGHT, _SQUARE = 190, 360


@dataclass(frozen=True, slots=True)
class Live:
    """What a page needs.

    Attributes
    ----------
    scripts : in their order
    hashes : of each, for the Content-Security-Policy
    pictures : title and the element that a picture is drawn in, as HTML
    """

    scripts: tuple[str, ...]
    hashes: tuple[str, ...]
    pictures: tuple[tuple[str, str], ...]


def live(result: RunResult, samples: Samples | None) -> Live | None:
    """Everything that can be looked into; None where there is nothing."""
    models = dict(_pictures(result, samples))
    if not models:
        return None
    embed: Any = import_module("bokeh.embed")
    resources: Any = import_module("bokeh.resources")
    script, divs = embed.components(models, wrap_script=False, wrap_plot_info=True)
    inline = resources.Resources(mode="inline", components=["bokeh"])
    library = "\n".join(inline.js_raw)
    library = re.sub(r"//[#@] sourceMappingURL=\S*", "", library)
    begin = "document.documentElement.classList.add('live');"
    scripts = tuple(text.replace("</script", "<\\/script") for text in (library, begin, script))
    return Live(scripts, tuple(map(_hash, scripts)), tuple(divs.items()))


def _hash(script: str) -> str:
    digest = hashlib.sha256(script.encode("utf-8")).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"


def _pictures(result: RunResult, samples: Samples | None) -> Iterator[tuple[str, Any]]:
    if samples is not None and len(samples) > 1:
        yield said("The whole run"), _run(result, samples)
        if plane := _phase_plane(result, samples):
            yield said("Phase plane of the oscillations"), plane
    if result.friction.curve is not None:
        yield said("Friction against speed"), _curve(result)
    if plots := _plant(result):
        yield said("The plant: Bode and Nyquist"), plots
    if samples is not None and (error := _following(result, samples.curves)):
        yield said("Following error before and after"), error


def _figure(x: str, y: str, *, height: int = _HEIGHT, **options: Any) -> Any:
    plotting: Any = import_module("bokeh.plotting")
    figure = plotting.figure(
        height=height, sizing_mode="stretch_width", tools=_TOOLS, active_drag="box_zoom",
        active_scroll=None, output_backend="canvas", x_axis_label=x, y_axis_label=y,
        background_fill_alpha=0, border_fill_alpha=0, min_width=280, **options,
    )  # fmt: skip
    figure.toolbar.logo = None
    for axis in figure.axis:
        axis.axis_label_text_color = axis.major_label_text_color = GREY
        axis.axis_line_color = axis.major_tick_line_color = axis.minor_tick_line_color = GREY
        axis.axis_label_text_font_style = "normal"
    figure.grid.grid_line_color = GREY
    figure.grid.grid_line_alpha = 0.25
    return figure


def _hover(figure: Any, *rows: tuple[str, str]) -> None:
    models: Any = import_module("bokeh.models")
    figure.add_tools(
        models.HoverTool(tooltips=list(rows), mode="mouse", point_policy="snap_to_data")
    )


def _effort(result: RunResult) -> str:
    return _safe(unit(result.units.effort))


def _safe(text: str) -> str:
    """A text of a file that anybody may have written: no formula, and nothing of HTML."""
    return re.sub(r"[^\w ·²./()%+-]", "", text)


def _source(**columns: Any) -> Any:
    models: Any = import_module("bokeh.models")
    return models.ColumnDataSource({k: np.asarray(v, np.float32) for k, v in columns.items()})


def _legend_below(figure: Any) -> None:
    """No legend on a curve."""
    if not figure.legend:
        return
    legend = figure.legend[0]
    figure.add_layout(legend, "below")
    legend.orientation = "horizontal"
    legend.click_policy = "hide"
    legend.background_fill_alpha = 0
    legend.border_line_alpha = 0
    legend.label_text_color = GREY
    legend.inactive_fill_alpha = 0.3
    legend.inactive_fill_color = GREY


def _run(result: RunResult, samples: Samples) -> Any:
    """Position, torque and velocity over the whole run, zoomed and moved together."""
    layouts: Any = import_module("bokeh.layouts")
    units = result.units
    p, e = units.position, _effort(result)
    columns = (samples.position, samples.command, velocity_of(samples))
    time, (position, torque, velocity) = reduced(samples.time, columns, _MOST)
    source = _source(t=time, q=position, u=torque, v=velocity)
    shown = (
        ("q", said("position"), p, BLUE), ("u", said("torque"), e, ORANGE),
        ("v", said("velocity"), f"{p}/s", GREEN),
    )  # fmt: skip
    figures: list[Any] = []
    for name, what, of, colour in shown:
        last = name == "v"
        figure = _figure(said("time in s") if last else "", f"{what}, {of}")
        if figures:
            figure.x_range = figures[0].x_range
        draw = figure.step if name == "u" else figure.line
        options = {"mode": "after"} if name == "u" else {}
        draw("t", name, source=source, color=colour, line_width=1.2, **options)
        _hover(figure, (said("time"), "@t{0.0000} s"), (what, f"@{name}{{0.[00000]}} {of}"))
        figures.append(figure)
    return layouts.column(figures, sizing_mode="stretch_width")


def _phase_plane(result: RunResult, samples: Samples) -> Any:
    watched = result.experiment
    cycles = watched.cycles if watched else ()
    if not cycles:
        return None
    p = result.units.position
    figure = _figure(f"{said('position')}, {p}", f"{said('velocity')}, {p}/s", height=_SQUARE)
    velocity = velocity_of(samples)
    for cycle, colour, dash in zip(cycles, (BLUE, ORANGE), ("solid", "dashed"), strict=False):
        cut = (samples.time >= cycle.begin) & (samples.time <= cycle.end)
        if np.count_nonzero(cut) < 2:
            continue
        source = _source(q=samples.position[cut], v=velocity[cut], t=samples.time[cut])
        figure.line(
            "q", "v", source=source, color=colour, line_dash=dash, legend_label=said(cycle.name)
        )
    if not figure.renderers:
        return None
    _hover(
        figure,
        (said("time"), "@t{0.0000} s"),
        ("q", f"@q{{0.[00000]}} {p}"),
        ("v", f"@v{{0.[000]}} {p}/s"),
    )
    _legend_below(figure)
    return figure


def _curve(result: RunResult) -> Any:
    """Friction by the law that was found, with its band, and the Coulomb level with its own."""
    models: Any = import_module("bokeh.models")
    curve, f = result.friction.curve, result.friction.coulomb
    assert curve is not None
    p, e = result.units.position, _effort(result)
    figure = _figure(f"{said('speed')}, {p}/s", f"{said('friction')}, {e}", height=_SQUARE)
    columns = {"w": curve.speed, "f": curve.friction}
    if curve.low and curve.high:
        columns |= {"low": curve.low, "high": curve.high}
        figure.varea("w", "low", "high", source=_source(**columns), color=BLUE, alpha=0.2)
    figure.line(
        "w", "f", source=_source(**columns), color=BLUE, line_width=2, legend_label=said("friction")
    )
    if f is not None and curve.speed:
        ends = [curve.speed[0], curve.speed[-1]]
        figure.line(
            ends,
            [f.value] * 2,
            color=ORANGE,
            line_dash="dashed",
            legend_label=said("Coulomb friction"),
        )
        if f.low is not None and f.high is not None:
            figure.add_layout(
                models.BoxAnnotation(bottom=f.low, top=f.high, fill_color=ORANGE, fill_alpha=0.2)
            )
    figure.y_range.start = 0
    _hover(
        figure, (said("speed"), f"@w{{0.[000]}} {p}/s"), (said("friction"), f"@f{{0.[00000]}} {e}")
    )
    _legend_below(figure)
    return figure


_LABELS = {"at_180": "−180°", "at_135": "−135°"}
_MARKS = {"naive": "x", "hysteresis": "square", "corrected": "circle", "measured": "triangle",
          "at_180": "diamond", "at_135": "inverted_triangle"}  # fmt: skip


def _plant(result: RunResult) -> Any:
    """G of the identified rigid axis, and the points that were read."""
    found, points = result.friction, result.critical_point
    if found.inertia is None or points is None or not found.inertia.value > 0:
        return None
    layouts: Any = import_module("bokeh.layouts")
    marks = {name: one for name in _MARKS if (one := points.point(name)) is not None}
    if not marks:
        return None
    periods = [one.period for one in marks.values()]
    w = np.geomspace(2 * np.pi / max(periods) / 5, 2 * np.pi / min(periods) * 5, 400)
    g = response_of(found, w)
    phase = np.degrees(np.unwrap(np.angle(g)))
    phase -= 360 * np.round((phase[0] + 90) / 360)
    gain = _safe(unit(result.units.gain))
    nyquist = _figure(
        f"{said('real part')}, {gain}", f"{said('imaginary part')}, {gain}", height=_SQUARE
    )
    source = _source(w=w, g=np.abs(g), ph=phase, re=g.real, im=g.imag)
    nyquist.line("re", "im", source=source, color=BLUE)
    size = 2.5 * max(one.gain for name, one in marks.items() if name != "at_135")
    nyquist.x_range.start, nyquist.x_range.end = -size, 0.2 * size
    nyquist.y_range.start, nyquist.y_range.end = -0.7 * size, 0.7 * size
    upper = _figure("", f"|G|, {gain}", y_axis_type="log", x_axis_type="log")
    lower = _figure("ω, rad/s", f"{said('phase')}, °", x_axis_type="log")
    lower.x_range = upper.x_range
    upper.line("w", "g", source=source, color=BLUE)
    lower.line("w", "ph", source=source, color=BLUE)
    for name, one in marks.items():
        angle, at = np.radians(one.phase_deg), 2 * np.pi / one.period
        look: dict[str, Any] = {"marker": _MARKS[name], "size": 9, "line_color": ORANGE}
        look["fill_alpha"] = 0
        x, y = one.gain * np.cos(angle), one.gain * np.sin(angle)
        nyquist.scatter([x], [y], legend_label=said(_LABELS.get(name, name)), **look)
        upper.scatter([at], [one.gain], **look)
        lower.scatter([at], [one.phase_deg], **look)
    rows = (
        ("ω", "@w{0.[00]} rad/s"),
        ("|G|", f"@g{{0.[0000]}} {gain}"),
        (said("phase"), "@ph{0.[0]}°"),
    )
    for figure in (nyquist, upper, lower):
        _hover(figure, *rows, (said("phase"), "@ph{0.[0]}°"))
    _legend_below(nyquist)
    return layouts.column([upper, lower, nyquist], sizing_mode="stretch_width")


def _following(result: RunResult, curves: Mapping[str, Array]) -> Any:
    found = result.verification
    if found is None:
        return None
    p = found.unit
    figure = _figure(said("time in s"), f"{said('following error')}, {p}", height=280)
    looks = ((GREY, "solid"), (GREEN, "dotted"), (ORANGE, "dashed"), (BLUE, "solid"))
    for number, step in enumerate(found.steps):
        curve = curves.get(f"verify.{number}")
        if curve is None or len(curve) != 3:
            continue
        colour, dash = looks[min(number, len(looks) - 1)] if number else (ORANGE, "dashed")
        colour, dash = (BLUE, "solid") if step.kept else (colour, dash)
        label = f"{100 * step.fraction:g} %" if step.fraction else said("without")
        line = figure.line(
            "t", "e", source=_source(t=curve[0], e=curve[2]), color=colour, line_dash=dash,
            line_width=2 if step.kept else 1.2, legend_label=label,
        )  # fmt: skip
        line.visible = step.kept or number == 0
    if not figure.renderers:
        return None
    _hover(figure, (said("time"), "@t{0.000} s"), (said("error"), f"@e{{0.[0000000]}} {p}"))
    _legend_below(figure)
    return figure
