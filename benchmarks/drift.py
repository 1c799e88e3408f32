"""Run lengths of the control chart, by simulation: `python benchmarks/run.py drift`.

A run is normal about the centre; after the baseline it is shifted by so many standard deviations.
Each figure is a mean over many histories with its standard error. The chart is the product's own.
"""

from __future__ import annotations

import math

import numpy as np

from commissioning.history.drift import Chart

HISTORIES = 4000
LONGEST = 10_000  # runs of one history; the few that get there count as that
SHIFTS = 0.0, 0.5, 1.0, 2.0  # standard deviations
CHANGES = 0.0, 5.0, 10.0, 12.0, 15.0, 20.0  # %
BASELINES = {"centre and sigma known": 0, "20 runs, growing": 20, "30 runs, growing": 30}


def run_length(
    baseline: int, shift: float, histories: int, *, sigma: float = 0.01, gate: float = 0.0
) -> tuple[float, float]:
    """Mean number of runs from the baseline to the alarm, and its standard error.

    `sigma`, `shift` : shares of the centre; `gate`: %
    """
    random = np.random.default_rng(1)
    found = []
    for _ in range(histories):
        if baseline:
            chart = Chart(baseline=baseline, gate=gate)
            for value in 1 + sigma * random.standard_normal(baseline):
                chart.add(float(value), 0.0)
        else:
            chart = Chart(centre=1.0, between=sigma, gate=gate)
        number = 0
        while number < LONGEST:
            block = 1 + shift + sigma * random.standard_normal(64)
            alarm = next((n for n, v in enumerate(block, 1) if chart.add(float(v), 0.0)), None)
            number += alarm or 64
            if alarm:
                break
        found.append(number)
    return float(np.mean(found)), float(np.std(found) / math.sqrt(histories))


def _cell(length: tuple[float, float]) -> str:
    mean, error = length
    if mean > LONGEST / 2:
        return f"over {LONGEST // 2}"
    digits = 0 if mean >= 100 else 1
    return f"{mean:.{digits}f} ± {error:.{digits}f}"


def drift(histories: int = HISTORIES) -> list[str]:
    """The run lengths as tables."""
    lines = [
        "# The control chart",
        "",
        "Written by `make bench` (`benchmarks/run.py drift`): mean number of runs from the baseline to an",
        f"alarm, by simulation of {histories} histories, with its standard error. EWMA, λ 0.2, limit",
        "2.86·√(λ/(2 − λ)); the chart is the product's own. Without a shift an alarm is false.",
        "",
        "Without the gate:",
        "",
        "| baseline | " + " | ".join(f"{s:g} σ" if s else "no shift" for s in SHIFTS) + " |",
        "| --- |" + " --- |" * len(SHIFTS),
    ]
    for name, baseline in BASELINES.items():
        cells = [_cell(run_length(baseline, 0.01 * s, histories)) for s in SHIFTS]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    lines += [
        "",
        f"With the gate of 10 %, a baseline of 20 runs, {histories // 20} histories:",
        "",
        "| scatter | " + " | ".join(f"+{c:g} %" if c else "no change" for c in CHANGES) + " |",
        "| --- |" + " --- |" * len(CHANGES),
    ]
    for sigma in (0.01, 0.02, 0.05):
        cells = [
            _cell(run_length(20, c / 100, histories // 20, sigma=sigma, gate=10.0)) for c in CHANGES
        ]
        lines.append(f"| {100 * sigma:g} % | " + " | ".join(cells) + " |")
    return lines
