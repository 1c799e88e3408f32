"""Pictures of a run, as SVG text.

Lines differ by dash and marker too: they survive a black print.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator
from numpy.typing import NDArray

from commissioning.identification.describing_function import equivalent, inverse_locus, relay
from commissioning.report.reduced import reduced
from commissioning.result.document import RunResult
from commissioning.result.experiment import Oscillated
from commissioning.result.found import Units
from commissioning.result.language import said
from commissioning.result.words import number, unit
from commissioning.result.worth import GainSet, Verification
from commissioning.samples import Array, Samples
from commissioning.tuning.margins import LEAST_MARGIN

__all__ = [
    "following",
    "friction_curve",
    "loci",
    "loci_svg",
    "narrows",
    "nyquist",
    "oscillations",
    "overview",
    "phase_plane",
    "progress",
    "stages",
    "svg",
    "tests_over_time",
    "tuning",
]

BLUE, ORANGE, GREY, GREEN = "#0b5394", "#c55a11", "#6b6b6b", "#2e7d32"
STYLE: Any = {
    "font.size": 9,
    "text.parse_math": False,  # names are names
    "font.family": "sans-serif",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "svg.hashsalt": "tworelay",
    "svg.fonttype": "none",
    "path.simplify": True,
}
_SHOWN_PERIODS = 3
_MOST_POINTS = 4000
_APART = 0.025  # of the picture: numbers of phases


def overview(samples: Samples, units: Units) -> Figure:
    """Position and torque over the whole run, with its phases."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.2, 3.6), layout="constrained")
        top, bottom = figure.subplots(2, 1, sharex=True)
        columns = (samples.position, samples.command)
        time, (position, command) = reduced(samples.time, columns, _MOST_POINTS)
        top.plot(time, position, color=BLUE, lw=0.7)
        top.set_ylabel(f"{said('position')}, {units.position}")
        bottom.plot(time, command, color=ORANGE, lw=0.5)
        bottom.set_ylabel(f"{said('torque')}, {unit(units.effort)}")
        bottom.set_xlabel(said("time in s"))
        number, last = 0, -np.inf
        apart = _APART * (samples.time[-1] - samples.time[0])
        for phase in samples.phases:
            if phase.at >= len(samples) or phase.kind != "step":
                continue
            number += 1
            at = samples.time[phase.at]
            for axes in (top, bottom):
                axes.axvline(at, color=GREY, lw=0.6, ls=":")
            if at - last < apart:
                continue
            last = at
            top.annotate(
                str(number), (at, 1.0), xycoords=("data", "axes fraction"), fontsize=8,
                xytext=(2, -2), textcoords="offset points", va="top", color=GREY,
            )  # fmt: skip
        return figure


def stages(samples: Samples) -> list[tuple[float, str]]:
    """Begin (s) and text of the phases that `overview` numbers."""
    return [
        (float(samples.time[phase.at]), phase.text)
        for phase in samples.phases
        if phase.at < len(samples) and phase.kind == "step"
    ]


def tests_over_time(samples: Samples, result: RunResult) -> str:
    """Position, torque and velocity over some periods of both oscillations."""
    units = result.units
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.2, 5.4), layout="constrained")
        grid = figure.subplots(3, 2, sharex="col", sharey="row")
        for column, cycle in enumerate(oscillations(result)):
            cut = _window(samples, cycle)
            time = (samples.time[cut] - samples.time[cut][0]) * 1000
            position, command = samples.position[cut], samples.command[cut]
            grid[0, column].plot(time, position, color=BLUE, lw=1.3)
            grid[1, column].step(time, command, color=ORANGE, lw=1.1, where="pre", label="command")
            torque = samples.torque[cut]
            if np.isfinite(torque).any():
                grid[1, column].plot(
                    time, torque, color=GREY, lw=0.9, ls="--", label="measured by the drive"
                )
            grid[2, column].plot(time, _velocity(samples, cut), color=GREEN, lw=1.1)
            grid[0, column].set_title(f"{cycle.name}: period {cycle.period * 1000:.4g} ms")
            grid[2, column].set_xlabel("time in ms")
        p, e = units.position, units.effort
        for row, label in enumerate((f"position in {p}", f"torque in {e}", f"velocity in {p}/s")):
            grid[row, 0].set_ylabel(label)
        grid[1, 0].legend(loc="upper right", fontsize=8)
        return svg(figure)


def oscillations(result: RunResult) -> tuple[Oscillated, ...]:
    """One oscillation at each of the two amplitudes; empty where the run did not get there."""
    cycles = result.experiment.cycles if result.experiment else ()
    return cycles[:2] if len(cycles) >= 2 else ()


def phase_plane(samples: Samples, result: RunResult) -> str:
    """Velocity over position of both oscillations."""
    units = result.units
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.5, 3.9), layout="constrained")
        axes = figure.subplots()
        for n, cycle in enumerate(oscillations(result)):
            cut = _window(samples, cycle)
            axes.plot(
                samples.position[cut], _velocity(samples, cut), lw=1.0,
                color=(BLUE, ORANGE)[n], ls=("-", "--")[n],
                label=f"d = ±{number(cycle.relay_amplitude, units.effort)}",
            )  # fmt: skip
        axes.set_xlabel(f"position in {units.position}")
        axes.set_ylabel(f"velocity in {units.position}/s")
        axes.legend(loc="upper right", fontsize=8)
        return svg(figure)


def nyquist(result: RunResult) -> str:
    """The −1/N loci of the relay tests, without and with friction, and the three readings of G."""
    points, watched = result.critical_point, result.experiment
    assert points is not None
    assert watched is not None
    coulomb = complex(*(watched.complex_coulomb or (0.0, 0.0)))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.7, 3.9), layout="constrained")
        axes = figure.subplots()
        for n, cycle in enumerate(oscillations(result)):
            d, eps, half_swing = cycle.relay_amplitude, cycle.hysteresis, cycle.half_swing
            if d is None or eps is None or half_swing is None:
                continue  # an oscillator is no relay and has no locus
            swings = np.linspace(eps * (1 + 1e-9), 2.2 * half_swing, 300)
            without = -1 / relay(swings, d, eps)
            with_friction = -1 / equivalent(swings, d, eps, coulomb)
            color = (BLUE, ORANGE)[n]
            name = f"d{n + 1}"
            _locus(axes, without, color, ":", f"−1/N, relay {name} alone")
            _locus(axes, with_friction, color, "-", f"−1/N, relay {name} and friction")
        largest = 0.0
        for key, marker, label in (
            ("naive", "x", "naive"),
            ("hysteresis", "s", "hysteresis only"),
            ("corrected", "o", "corrected"),
        ):
            point = points.point(key)
            if point is None:
                continue
            angle = np.radians(point.phase_deg)
            axes.plot(
                point.gain * np.cos(angle), point.gain * np.sin(angle), marker=marker, ls="",
                ms=7, mfc="none", mew=1.6, color="black", label=f"G(jω), {label}",
            )  # fmt: skip
            largest = max(largest, 1.6 * point.gain)
        axes.set_xlim(-largest, 0.15 * largest)
        axes.set_ylim(-0.75 * largest, 0.55 * largest)
        axes.axhline(0, color=GREY, lw=0.8)
        axes.axvline(0, color=GREY, lw=0.8)
        axes.set_xlabel(f"real part in {result.units.gain}")
        axes.set_ylabel(f"imaginary part in {result.units.gain}")
        axes.legend(loc="lower left", fontsize=6.5)
        return svg(figure)


_MULTIPLES = (1.3, 2.0, 4.0)  # of the friction: amplitudes of the loci
_DASHES = ("-", "--", "-.")


def loci(
    result: RunResult, amplitude: float | None = None, hysteresis: float | None = None
) -> Figure:
    """The thesis' Figures 4, 5 and 6 for this axis: the loci −1/N beside the identified G.

    −1/N over the amplitude d without hysteresis, over d with one hysteresis, and over the
    hysteresis with one d (half of the relay's swing, N.m or N; half-width, rad or m). Default:
    those of the run's relay.

    Raises ValueError where the run has no oscillation, no point or no friction.
    """
    shown, points, coulomb = oscillations(result), result.critical_point, result.friction.coulomb
    around = None if points is None else points.corrected or points.naive
    if not shown or around is None or coulomb is None:
        raise ValueError("no oscillation, no point of the plant or no friction")
    f = coulomb.value
    d = amplitude or shown[0].relay_amplitude or f
    eps = hysteresis or shown[0].hysteresis or 0.0
    gain, effort = result.units.gain, result.units.effort
    largest = 2.0 * around.gain
    amplitudes = [m * f for m in _MULTIPLES]
    panels: list[tuple[str, list[tuple[float, float]], str]] = [
        ("Figure 4: over d, ε = 0", [(x, 0.0) for x in amplitudes], f"d = {{d:.3g}} {effort}"),
        (
            f"Figure 5: over d, ε = {eps:.3g}",
            [(x, eps) for x in amplitudes],
            f"d = {{d:.3g}} {effort}",
        ),
        (
            f"Figure 6: over ε, d = {d:.3g}",
            [(d, m * eps) for m in (0.5, 1.0, 2.0)],
            f"ε = {{e:.3g}} {result.units.position}",
        ),
    ]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 3.6), layout="constrained")
        row = figure.subplots(1, 3, sharex=True, sharey=True)
        for axes, (title, settings, label) in zip(row, panels, strict=True):
            _identified(axes, result, largest)
            for (x, e), dash, color in zip(settings, _DASHES, (BLUE, ORANGE, GREEN), strict=True):
                far = _furthest(largest, x, f)
                swings = e + np.geomspace(1e-9 * far, far, 500)
                values = inverse_locus(swings, x, e, f)
                _locus(axes, values, color, dash, label.format(d=x, e=e))
            axes.set_title(title, fontsize=9)
            axes.axhline(0, color=GREY, lw=0.7)
            axes.axvline(0, color=GREY, lw=0.7)
            axes.set_xlabel(f"real part in {gain}")
            axes.legend(loc="lower left", fontsize=6.5)
        row[0].set_xlim(-largest, 0.12 * largest)
        row[0].set_ylim(-0.75 * largest, 0.75 * largest)
        row[0].set_ylabel(f"imaginary part in {gain}")
        return figure


def _furthest(largest: float, d: float, f: float) -> float:
    """Half-swing beyond the hysteresis at which a locus has left the picture, rad or m."""
    return 1.5 * largest * 4 / np.pi * float(np.hypot(d, f))


def _identified(axes: Axes, result: RunResult, largest: float) -> None:
    """G(jω) of the identified rigid axis, and where the relay's own frequency lies on it."""
    found = result.friction
    j, b, tau = (q.value if q else 0.0 for q in (found.inertia, found.viscous, found.dead_time))
    if not j > 0:
        return
    low = 0.3 * float(np.sqrt(1 / (j * 2 * largest)))
    s = 1j * np.geomspace(low, 100 * low, 600)
    g = np.exp(-s * tau) / (j * s**2 + b * s)
    axes.plot(g.real, g.imag, color="black", lw=1.4, label="G(jω), identified")
    point = result.critical_point.corrected if result.critical_point else None
    if point:
        z = point.gain * np.exp(1j * np.radians(point.phase_deg))
        axes.plot(z.real, z.imag, "o", mfc="none", mew=1.4, ms=6, color="black", ls="",
                  label="G, relay test corrected")  # fmt: skip


def loci_svg(result: RunResult) -> str:
    """`loci` for the report."""
    return svg(loci(result))


def tuning(result: RunResult, loop: str, curves: Mapping[str, Array]) -> str:
    """Phase margin of each rule, naive against corrected, and a step with friction."""
    sets = [s for s in result.of_loop(loop) if s.gains]
    rules = list(dict.fromkeys(s.rule for s in sets))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 0.3 * len(rules) + 1.3), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1, 1.1))
        left.axvspan(
            _MARGIN_RANGE[0], LEAST_MARGIN, color="#e8e8e8", hatch="//", ec="#cccccc", lw=0
        )
        for y, rule in enumerate(reversed(rules)):
            found = {s.source: s for s in sets if s.rule == rule}
            ends = {k: _clipped(s.phase_margin_deg) for k, s in found.items()}
            if len(ends) == 2:
                left.plot(list(ends.values()), [y, y], color=GREY, lw=1)
            for source, x in ends.items():
                marker, face = ("x", "black") if source == "naive" else ("o", BLUE)
                left.plot(x, y, marker=marker, color=face, ms=6, mew=1.5, ls="")
                if source == "corrected" and found[source].proposed:
                    left.plot(x, y, marker="o", ms=11, mfc="none", color=BLUE, ls="")
        left.set_yticks(range(len(rules)), list(reversed(rules)), fontsize=8)
        left.set_xlim(*_MARGIN_RANGE)
        left.set_ylim(-0.7, len(rules) - 0.3)
        left.set_xlabel("phase margin in degrees (below 0: unstable)")
        left.set_title("× naive    ● corrected    ◎ proposed    grey: too little", fontsize=8)
        _steps(right, sets, result.units.position, curves)
        return svg(figure)


_MARGIN_RANGE = (-30.0, 85.0)


def _clipped(value: float | None) -> float:
    return (
        _MARGIN_RANGE[0] if value is None else min(max(value, _MARGIN_RANGE[0]), _MARGIN_RANGE[1])
    )


def _steps(axes: Axes, sets: Sequence[GainSet], unit: str, curves: Mapping[str, Array]) -> None:
    """The best set, and the rule that takes the distorted point, naive beside corrected."""
    best = next((s.rule for s in sets if s.best), None)
    longest = size = 0.0
    for rule, color in ((best, BLUE), ("astrom-hagglund", ORANGE)):
        for item in sets:
            step, curve = item.step, curves.get(f"step.{item.name}")
            if item.rule != rule or step is None or (color == ORANGE and rule == best):
                continue
            if curve is None or len(curve) != 2 or not curve.size:
                continue
            time, position = curve
            naive = item.source == "naive"
            axes.plot(
                time * 1000, position, color=color, lw=1.1 if naive else 1.7,
                ls="--" if naive else "-", label=f"{rule}, {item.source}",
            )  # fmt: skip
            size = step.size
            longest = max(longest, min(1.6 * (step.settling or time[-1]), time[-1]))
    if not size:
        axes.set_axis_off()
        return
    axes.axhline(size, color=GREY, lw=0.9, ls=":", label="reference")
    axes.set_xlim(0, 1000 * longest)
    axes.set_ylim(-0.05 * size, 1.8 * size)
    axes.set_xlabel("time in ms")
    axes.set_ylabel(f"position in {unit}")
    axes.set_title("a step with the friction that was found, not compensated", fontsize=8)
    axes.legend(loc="upper right", fontsize=7)


def friction_curve(result: RunResult) -> str:
    """Friction against speed by the law that was found, Coulomb level and interval beside it."""
    units, f, curve = result.units, result.friction.coulomb, result.friction.curve
    assert curve is not None
    speed, level = np.array(curve.speed), np.array(curve.friction)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.7, 3.3), layout="constrained")
        axes = figure.subplots()
        axes.plot(speed, level, color=BLUE, lw=1.6, label="friction, mean of both directions")
        top = level.max()
        if curve.low and curve.high:
            axes.fill_between(speed, curve.low, curve.high, color=BLUE, alpha=0.2, lw=0)
        if f is not None:
            axes.axhline(f.value, color=ORANGE, lw=1.1, ls="--", label="Coulomb friction")
            if f.low is not None and f.high is not None:
                axes.axhspan(f.low, f.high, color=ORANGE, alpha=0.2, lw=0)
            top = max(top, f.high or f.value)
        axes.set_ylim(0, 1.15 * top)
        axes.set_xlim(0, speed[-1])
        axes.set_xlabel(f"speed in {units.position}/s")
        axes.set_ylabel(f"friction in {units.effort}")
        axes.legend(loc="lower right", fontsize=8)
        return svg(figure)


def narrows(result: RunResult) -> bool:
    """Whether there is something to be seen of what fewer periods would have given."""
    found = result.methods.output_error
    return found is not None and len(found.progress) > 1


def progress(result: RunResult) -> str:
    """The interval of the friction over the periods that it was measured by."""
    found, f = result.methods.output_error, result.friction.coulomb
    assert found is not None
    steps = found.progress
    periods = [one.periods for one in steps]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.4, 2.6), layout="constrained")
        left, right = figure.subplots(1, 2)
        value = f.value if f else steps[-1].coulomb
        middle = [one.coulomb for one in steps]
        arms = [
            [one.coulomb - one.low for one in steps], [one.high - one.coulomb for one in steps],
        ]  # fmt: skip
        left.errorbar(
            periods, middle, arms, color=BLUE, marker="o", ms=4, lw=1.2, capsize=3,
            label="friction and its interval",
        )  # fmt: skip
        left.axhline(value, color=ORANGE, lw=1.1, ls="--", label="the number")
        left.set_ylabel(f"friction in {result.units.effort}")
        left.legend(loc="lower right", fontsize=7)
        widths = [50 * (one.high - one.low) / abs(value) for one in steps]
        right.semilogy(periods, widths, color=BLUE, marker="s", ms=4, lw=1.2)
        right.set_ylabel("half of the interval in %")
        right.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        right.yaxis.set_minor_locator(NullLocator())
        right.yaxis.set_major_formatter(lambda value, _: f"{value:.2g}")
        for axes in (left, right):
            axes.set_xlabel("periods")
            axes.xaxis.get_major_locator().set_params(integer=True)
        return svg(figure)


def following(found: Verification, curves: Mapping[str, Array]) -> Figure | None:
    """Following error after reversals, without compensation and with what stays.

    None without a record.
    """
    kept = next((n for n, step in enumerate(found.steps) if step.kept), len(found.steps) - 1)
    before, after = (curves.get(f"verify.{n}") for n in (0, kept))
    if before is None or after is None or len(before) != 3 or len(after) != 3:
        return None
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.2, 3.6), layout="constrained")
        top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(1, 2))
        top.plot(before[0], before[1], color=GREY, lw=1.0)
        top.set_ylabel(f"{said('position')}, {found.unit}")
        bottom.plot(before[0], before[2], color=ORANGE, lw=1.0, ls="--", label=said("without"))
        share = 100 * found.steps[kept].fraction
        bottom.plot(after[0], after[2], color=BLUE, lw=1.3, label=f"{share:g} %")
        bottom.set_ylabel(f"{said('error')}, {found.unit}")
        bottom.set_xlabel(said("time in s"))
        top.legend(
            *bottom.get_legend_handles_labels(),
            loc="lower center",
            ncols=2,
            bbox_to_anchor=(0.5, 1.0),
        )
        return figure


def _locus(axes: Axes, values: NDArray[Any], color: str, dash: str, label: str) -> None:
    axes.plot(values.real, values.imag, color=color, ls=dash, lw=1.2, label=label)


def _window(samples: Samples, cycle: Oscillated) -> NDArray[np.intp]:
    """Indices of the last few periods of an oscillation."""
    first = max(cycle.begin, cycle.end - _SHOWN_PERIODS * cycle.period)
    time = samples.time
    return np.flatnonzero((time >= first) & (time <= cycle.end))


def _velocity(samples: Samples, cut: Sequence[int] | NDArray[np.intp]) -> NDArray[np.float64]:
    """Velocity by central differences over the record's own time stamps."""
    time, position = samples.time[cut], samples.position[cut]
    gradient: NDArray[np.float64] = np.gradient(position, time)
    return gradient


def svg(figure: Figure) -> str:
    """A figure as an element of a page."""
    stream = io.StringIO()
    figure.savefig(stream, format="svg", metadata={"Date": None})
    text = stream.getvalue()
    return text[text.index("<svg") :]
