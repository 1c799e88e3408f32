"""Pictures of a run, as SVG text. Lines differ by dash and marker too: they survive a black print."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from commissioning.identification.describing_function import equivalent, relay
from commissioning.runs import Samples

__all__ = ["friction_curve", "nyquist", "overview", "phase_plane", "tests_over_time"]

BLUE, ORANGE, GREY, GREEN = "#0b5394", "#c55a11", "#6b6b6b", "#2e7d32"
_STYLE: Any = {
    "font.size": 9,
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


def overview(samples: Samples, units: dict[str, str]) -> str:
    """Position and torque over the whole run, with its phases."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(9.2, 3.6), layout="constrained")
        top, bottom = figure.subplots(2, 1, sharex=True)
        step = max(1, len(samples) // _MOST_POINTS)
        time = samples["time"][::step]
        top.plot(time, samples["position"][::step], color=BLUE, lw=0.7)
        top.set_ylabel(f"position in {units['position']}")
        bottom.plot(time, samples["command"][::step], color=ORANGE, lw=0.5)
        bottom.set_ylabel(f"torque in {units['effort']}")
        bottom.set_xlabel("time in s")
        number = 0
        for index, text in samples.phases:
            if index >= len(samples) or not _is_stage(text):
                continue
            number += 1
            at = samples["time"][index]
            for axes in (top, bottom):
                axes.axvline(at, color=GREY, lw=0.6, ls=":")
            top.annotate(
                str(number), (at, 1.0), xycoords=("data", "axes fraction"), fontsize=8,
                xytext=(2, -2), textcoords="offset points", va="top", color=GREY,
            )  # fmt: skip
        return _svg(figure)


def stages(samples: Samples) -> list[tuple[float, str]]:
    """Begin (s) and text of the phases that `overview` numbers."""
    return [
        (float(samples["time"][index]), text)
        for index, text in samples.phases
        if index < len(samples) and _is_stage(text)
    ]


def _is_stage(text: str) -> bool:
    return not text.startswith(("staging", "relay test 2, ", "stop path", "a dozen periods"))


def tests_over_time(samples: Samples, result: dict[str, Any]) -> str:
    """Position, torque and velocity over some periods of both oscillations."""
    units = result["units"]
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(9.2, 5.4), layout="constrained")
        grid = figure.subplots(3, 2, sharex="col", sharey="row")
        for column, (begin, end) in enumerate(result["experiment"]["spans"]):
            cut, period = _window(samples, result, column, begin, end)
            time = (samples["time"][cut] - samples["time"][cut][0]) * 1000
            position, command = samples["position"][cut], samples["command"][cut]
            grid[0, column].plot(time, position, color=BLUE, lw=1.3)
            grid[1, column].step(time, command, color=ORANGE, lw=1.1, where="pre", label="command")
            torque = samples["torque"][cut]
            if np.isfinite(torque).any():
                grid[1, column].plot(
                    time, torque, color=GREY, lw=0.9, ls="--", label="measured by the drive"
                )
            grid[2, column].plot(time, _velocity(samples, cut), color=GREEN, lw=1.1)
            name = result["experiment"]["cycles"][column]["name"]
            grid[0, column].set_title(f"{name}: period {period * 1000:.4g} ms")
            grid[2, column].set_xlabel("time in ms")
        p, e = units["position"], units["effort"]
        for row, label in enumerate((f"position in {p}", f"torque in {e}", f"velocity in {p}/s")):
            grid[row, 0].set_ylabel(label)
        grid[1, 0].legend(loc="upper right", fontsize=8)
        return _svg(figure)


def phase_plane(samples: Samples, result: dict[str, Any]) -> str:
    """Velocity over position of both oscillations."""
    units = result["units"]
    cycles = result["experiment"]["cycles"]
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(4.5, 3.9), layout="constrained")
        axes = figure.subplots()
        for n, (begin, end) in enumerate(result["experiment"]["spans"]):
            cut, _ = _window(samples, result, n, begin, end)
            axes.plot(
                samples["position"][cut], _velocity(samples, cut), lw=1.0,
                color=(BLUE, ORANGE)[n], ls=("-", "--")[n],
                label=f"d = ±{cycles[n]['relay_amplitude']:.3g} {units['effort']}",
            )  # fmt: skip
        axes.set_xlabel(f"position in {units['position']}")
        axes.set_ylabel(f"velocity in {units['position']}/s")
        axes.legend(loc="upper right", fontsize=8)
        return _svg(figure)


def nyquist(result: dict[str, Any]) -> str:
    """The −1/N loci of the relay tests, without and with friction, and the three readings of G."""
    cycles, points = result["experiment"]["cycles"], result["critical_point"]
    coulomb = complex(*result["experiment"]["complex_coulomb"])
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(4.7, 3.9), layout="constrained")
        axes = figure.subplots()
        for n in (0, 1):
            d, eps = cycles[n]["relay_amplitude"], cycles[n]["hysteresis"]
            if eps is None:  # an oscillator is no relay and has no locus
                continue
            swings = np.linspace(eps * (1 + 1e-9), 2.2 * cycles[n]["half_swing"], 300)
            without = -1 / relay(swings, d, eps)
            with_friction = -1 / equivalent(swings, d, eps, coulomb)
            color = (BLUE, ORANGE)[n]
            name = f"d{n + 1}"
            _locus(axes, without, color, ":", f"−1/N, relay {name} alone")
            _locus(axes, with_friction, color, "-", f"−1/N, relay {name} and friction")
        for key, marker, label in (
            ("naive", "x", "naive"),
            ("hysteresis", "s", "hysteresis only"),
            ("corrected", "o", "corrected"),
        ):
            point = points[key]
            if point is None:
                continue
            angle = np.radians(point["phase_deg"])
            axes.plot(
                point["gain"] * np.cos(angle), point["gain"] * np.sin(angle), marker=marker, ls="",
                ms=7, mfc="none", mew=1.6, color="black", label=f"G(jω), {label}",
            )  # fmt: skip
        largest = 1.6 * max(points[key]["gain"] for key in ("naive", "corrected") if points[key])
        axes.set_xlim(-largest, 0.15 * largest)
        axes.set_ylim(-0.75 * largest, 0.55 * largest)
        axes.axhline(0, color=GREY, lw=0.8)
        axes.axvline(0, color=GREY, lw=0.8)
        axes.set_xlabel(f"real part in {result['units']['gain']}")
        axes.set_ylabel(f"imaginary part in {result['units']['gain']}")
        axes.legend(loc="lower left", fontsize=6.5)
        return _svg(figure)


def friction_curve(result: dict[str, Any]) -> str:
    """Friction against speed by the law that was found, Coulomb level and interval beside it."""
    units, friction = result["units"], result["friction"]
    curve = result["methods"]["modulating"]["curve"]
    speed, level = np.array(curve["speed"]), np.array(curve["friction"])
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(4.7, 3.3), layout="constrained")
        axes = figure.subplots()
        axes.plot(speed, level, color=BLUE, lw=1.6, label="friction, mean of both directions")
        f = friction["coulomb"]
        axes.axhline(f["value"], color=ORANGE, lw=1.1, ls="--", label="Coulomb friction")
        axes.axhspan(f["low"], f["high"], color=ORANGE, alpha=0.2, lw=0)
        axes.set_ylim(0, 1.15 * max(level.max(), f["high"]))
        axes.set_xlim(0, speed[-1])
        axes.set_xlabel(f"speed in {units['position']}/s")
        axes.set_ylabel(f"friction in {units['effort']}")
        axes.legend(loc="lower right", fontsize=8)
        return _svg(figure)


def _locus(axes: Axes, values: NDArray[Any], color: str, dash: str, label: str) -> None:
    axes.plot(values.real, values.imag, color=color, ls=dash, lw=1.2, label=label)


def _window(
    samples: Samples, result: dict[str, Any], test: int, begin: float, end: float
) -> tuple[NDArray[np.intp], float]:
    """Indices of the last few periods of a test, and its period in s."""
    period = result["experiment"]["cycles"][test]["period"]
    first = max(begin, end - _SHOWN_PERIODS * period)
    time = samples["time"]
    return np.flatnonzero((time >= first) & (time <= end)), period


def _velocity(samples: Samples, cut: Sequence[int] | NDArray[np.intp]) -> NDArray[np.float64]:
    """Velocity by central differences over the record's own time stamps."""
    time, position = samples["time"][cut], samples["position"][cut]
    gradient: NDArray[np.float64] = np.gradient(position, time)
    return gradient


def _svg(figure: Figure) -> str:
    stream = io.StringIO()
    figure.savefig(stream, format="svg", metadata={"Date": None})
    text = stream.getvalue()
    return text[text.index("<svg") :]
