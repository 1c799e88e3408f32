"""The plant's points against the true plant, and margins against the loop simulated."""

from __future__ import annotations

import cmath
import math
import os
import statistics
import sys
import tempfile
from collections import deque
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from benchmarks.methods import (  # noqa: E402
    CYCLES,
    GOALS,
    OTHERS,
    ROOM,
    TORQUE,
    WATCHDOG,
    WATCHDOG_CYCLES,
    link_of,
)
from commissioning.desk import Desk, Options  # noqa: E402
from commissioning.interruption import Interruption  # noqa: E402
from commissioning.journal import Journal  # noqa: E402
from commissioning.result.found import POINTS, Point  # noqa: E402
from commissioning.result.worth import GainSet  # noqa: E402
from commissioning.rig.armed import Failure  # noqa: E402
from commissioning.session import identify as session  # noqa: E402
from commissioning.session.tune import DriveLoop, tune  # noqa: E402
from commissioning.tuning.controllers import law  # noqa: E402
from commissioning.tuning.rules import Cascade, Pid  # noqa: E402
from drivers.link import axis_of, parse  # noqa: E402
from drivers.virtual.axes import VirtualAxis, configured  # noqa: E402
from profiles.errors import TwoRelayError  # noqa: E402
from profiles.library import load_profile  # noqa: E402

READINGS = ("naive", "hysteresis", "corrected", "measured")
WANTED = ("at_180", "at_135")
PERIOD = 0.00025  # s, of the virtual drive's own loops


@dataclass
class Outcome:
    """One axis at one cycle: errors of the points in per cent and degrees, of the margins in degrees."""

    axis: str
    cycle: float
    points: dict[str, tuple[float, float, str, bool | None]] = field(default_factory=dict)
    margins: dict[str, list[float]] = field(default_factory=dict)
    verdict: str = ""
    refused: str = ""


def plant_of(axis: VirtualAxis, w: float) -> complex:
    """The virtual axis between torque in force and position at ω, rad/s, friction left out."""
    s = 1j * w
    late = cmath.exp(-s * axis.delay) / (1 + s * axis.lag)
    if not axis.resonance:
        return late / (axis.inertia * s * s + axis.viscous * s)
    load = axis.inertia * axis.ratio / (1 + axis.ratio)
    motor = axis.inertia - load
    reduced = motor * load / axis.inertia
    resonance = 2 * math.pi * axis.resonance
    spring = reduced * resonance**2 + 2 * axis.damping * reduced * resonance * s
    return late / (motor * s * s + axis.viscous * s + spring - spring**2 / (load * s * s + spring))


def run(case: tuple[str, float]) -> Outcome:
    name, cycle = case
    outcome = Outcome(name, cycle)
    link = link_of(name, cycle, False)
    virtual = configured(name, parse(link).options)
    axis = axis_of(link)
    watchdog = max(WATCHDOG, WATCHDOG_CYCLES * cycle)
    axis = axis.model_copy(update={"limits": axis.limits.model_copy(update={"watchdog": watchdog})})
    options = Options(cycle=cycle, travel=ROOM[name], max_torque=TORQUE.get(name), points=True)
    try:
        with (
            tempfile.TemporaryDirectory() as folder,
            Journal(Path(folder)) as journal,
            Interruption() as interruption,
        ):
            desk = Desk(journal, interruption, lambda text: None, lambda question, word: True)
            result = session.identify(axis, options, desk)
    except Failure as failure:
        outcome.refused = str(failure.error)
        return outcome
    outcome.verdict = result.quality.verdict or ""
    for key in POINTS:
        point = result.critical_point.point(key) if result.critical_point else None
        if point is not None:
            outcome.points[key] = compared(point, virtual)
    try:
        tuned = tune(result, axis, load_profile("virtual-modbus"), DriveLoop())
    except TwoRelayError as error:
        outcome.refused = str(error)
        return outcome
    for found in tuned.sets:
        if found.proposed:
            moved = against_simulation(found, virtual, cycle)
            if moved is not None:
                outcome.margins.setdefault(found.loop, []).append(moved)
    return outcome


def compared(point: Point, virtual: VirtualAxis) -> tuple[float, float, str, bool | None]:
    """Errors of gain and phase against the true plant at the point's own frequency, how, covered."""
    truth = plant_of(virtual, 2 * math.pi / point.period)
    gain = 100 * (point.gain / abs(truth) - 1)
    turned = (point.phase_deg - math.degrees(cmath.phase(truth)) + 180) % 360 - 180
    covered = None
    if point.gain_low is not None and point.gain_high is not None:
        turn = (point.phase_high_deg or point.phase_deg) - point.phase_deg
        covered = point.gain_low <= abs(truth) <= point.gain_high and abs(turned) <= turn
    return gain, turned, point.how, covered


# -- margins ------------------------------------------------------------------------------------------


def without_friction(virtual: VirtualAxis) -> VirtualAxis:
    return replace(
        virtual, coulomb=0.0, breakaway=0.0, load=0.0, asymmetry=0.0, stribeck=0.0, soft=0.0,
        load_friction=0.0, load_coulomb=0.0, cogging=0.0,
    )  # fmt: skip


def loop_gain(found: GainSet, virtual: VirtualAxis, cycle: float, w: float) -> complex:
    """L at ω of the closed loop, simulated: a sine is added to the torque, and both sides are read."""
    gains = {k: math.inf if v is None else v for k, v in found.gains.items()}
    controller = law(
        Cascade(**gains) if "velocity_gain" in gains else Pid(**gains), cycle, math.inf, 0.0
    )
    plant = without_friction(virtual).build()
    dead = virtual.delay if found.loop == "host" else 0.0
    cycles = math.ceil(dead / cycle - 1e-9)
    late = dead - (cycles - 1) * cycle if cycles else 0.0
    waiting: deque[float] = deque([0.0] * max(cycles - 1, 0))
    period = max(round(2 * math.pi / w / cycle), 2)
    w = 2 * math.pi / (period * cycle)
    size = 1e-3 * virtual.rated
    settle = math.ceil(40 / w / cycle / period) + 12
    sums, before = [0j, 0j], 0.0
    for k in range((settle + 4) * period):
        fed_back = controller(0.0, plant.position)
        into = fed_back + size * math.sin(w * k * cycle)
        if k >= settle * period:
            turn = cmath.exp(-1j * w * k * cycle)
            sums[0] += fed_back * turn
            sums[1] += into * turn
        waiting.append(into)
        if late > 0:
            plant.advance(late, before)
        before = waiting.popleft()
        if cycle > late:
            plant.advance(cycle - late, before)
    return -sums[0] / sums[1]


def against_simulation(found: GainSet, virtual: VirtualAxis, cycle: float) -> float | None:
    """Phase margin predicted less the one of the simulated loop, degrees; None without a crossover."""
    step = cycle if found.loop == "host" else PERIOD
    crossover = found.crossover or 0.0
    low, high = 0.5 * crossover, min(1.8 * crossover, 0.7 * math.pi / step)
    values = {}
    for _ in range(2):  # |L| falls: a secant in logarithms
        for w in (low, high):
            values[w] = loop_gain(found, virtual, step, w)
        a, b = (math.log(abs(values[w])) for w in (low, high))
        if not math.isfinite(a + b) or a * b >= 0:
            return None
        at = math.exp(math.log(low) + a / (a - b) * math.log(high / low))
        low, high = 0.93 * at, min(1.07 * at, 0.75 * math.pi / step)
    ends = [values.get(w) or loop_gain(found, virtual, step, w) for w in (low, high)]
    a, b = (math.log(abs(v)) for v in ends)
    share = a / (a - b)
    turns = [math.degrees(cmath.phase(v)) % -360 for v in ends]
    simulated = 180 + turns[0] + share * (turns[1] - turns[0])
    return (found.phase_margin_deg or 0.0) - simulated


# -- tables -------------------------------------------------------------------------------------------


def spread(values: list[float]) -> str:
    if not values:
        return "–"
    sizes = [abs(v) for v in values]
    return f"{statistics.median(sizes):.2f} / {max(sizes):.2f}"


def rows_of(outcomes: list[Outcome]) -> list[str]:
    lines = [
        "| reading | gain, % | phase, ° | interval covers | points |",
        "| --- | --- | --- | --- | --- |",
    ]
    kinds: list[tuple[str, str | None]] = [(key, None) for key in READINGS]
    kinds += [(key, how) for key in WANTED for how in ("measured", "computed")]
    for key, how in kinds:
        found = [
            o.points[key] for o in outcomes if key in o.points and how in (None, o.points[key][2])
        ]
        covered = [p[3] for p in found if p[3] is not None]
        lines.append(
            f"| {key}{f', {how}' if how else ''} | {spread([p[0] for p in found])} | "
            f"{spread([p[1] for p in found])} | "
            f"{f'{sum(covered)} of {len(covered)}' if covered else '–'} | {len(found)} |"
        )
    return lines


def critical_point() -> list[str]:
    cases = [(name, cycle) for name in (*GOALS, *OTHERS) for cycle in CYCLES]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        outcomes = list(pool.map(run, cases))
    done = [o for o in outcomes if o.points]
    lines = [
        "# The critical point",
        "",
        "Written by `make bench`. Each reading against the true plant between torque in force and position at",
        "its own frequency, the hold left out: median / worst of the absolute error over the axes at 1, 4, 10",
        "and 20 ms. `naive` is what a relay autotuner concludes.",
        "",
    ]
    for title, names in (
        ("Axes 1–6, 8–10, 14, 15 of the bench", GOALS),
        ("The others: strongly damped, soft friction twice, series elastic", OTHERS),
    ):
        chosen = [o for o in done if o.axis in names]
        lines += [f"## {title}", "", *rows_of(chosen), ""]
    lines += [
        "## By axis",
        "",
        "Gain in per cent and phase in degrees, worst of the four cycles; M: how many of the four points were",
        "measured. Margins: worst difference in degrees between the phase margin predicted on the identified",
        "axis and the one of the loop simulated with the true one, over every set that is proposed.",
        "",
        "| axis | naive | hysteresis | corrected | measured | −180° | M | −135° | M | margins host | drive |",
        "| --- |" + " --- |" * 10,
    ]
    for name in (*GOALS, *OTHERS):
        mine = [o for o in done if o.axis == name]
        cells = [worst([o.points[key] for o in mine if key in o.points]) for key in READINGS]
        for key in WANTED:
            found = [o.points[key] for o in mine if key in o.points]
            cells += [worst(found), str(sum(p[2] == "measured" for p in found))]
        for loop in ("host", "drive"):
            off = [abs(x) for o in mine for x in o.margins.get(loop, [])]
            cells.append(f"{max(off):.2f}" if off else "–")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    margins = {
        loop: [x for o in done for x in o.margins.get(loop, [])] for loop in ("host", "drive")
    }
    lines += ["", "Phase margins predicted against simulated, degrees, median / worst: "]
    lines += [f"{loop} {spread(values)} of {len(values)} sets" for loop, values in margins.items()]
    refused = [o for o in outcomes if o.refused]
    if refused:
        lines += ["", "Refused:", ""]
        lines += [f"- {o.axis} at {o.cycle * 1000:g} ms: {o.refused}" for o in refused]
    return lines


def worst(points: list[tuple[float, float, str, bool | None]]) -> str:
    if not points:
        return "–"
    gain = max((p[0] for p in points), key=abs)
    turned = max((p[1] for p in points), key=abs)
    return f"{gain:+.1f} {turned:+.1f}°"


if __name__ == "__main__":
    table = critical_point()
    (HERE / "critical_point.md").write_text("\n".join(table) + "\n", "utf-8")
    print("\n".join(table))
