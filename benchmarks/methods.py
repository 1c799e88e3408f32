"""Every axis, cycle and method against the truth, and what an engineer would use instead."""

from __future__ import annotations

import os
import statistics
import sys
import tempfile
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

import numpy as np  # noqa: E402
from scipy.signal import butter, filtfilt  # noqa: E402

from benchmarks.classes import Case  # noqa: E402
from commissioning.desk import Desk, Options  # noqa: E402
from commissioning.identification.record import Record  # noqa: E402
from commissioning.identification.steady import SteadyFit, SteadyPoint, fit  # noqa: E402
from commissioning.interruption import Interruption  # noqa: E402
from commissioning.journal import Journal  # noqa: E402
from commissioning.result.document import RunResult  # noqa: E402
from commissioning.rig.armed import Failure  # noqa: E402
from commissioning.runs import RunFolder  # noqa: E402
from commissioning.session import identify as session  # noqa: E402
from drivers.link import axis_of, open_drive, parse  # noqa: E402
from drivers.sample import Sample  # noqa: E402
from drivers.virtual.axes import AXES, VirtualAxis, configured  # noqa: E402
from profiles.axis import Axis  # noqa: E402
from profiles.errors import TwoRelayError  # noqa: E402
from profiles.procedures import Mode  # noqa: E402

CYCLES = (0.001, 0.004, 0.010, 0.020)
LATE = "jitter=0.1&loss=0.02"
METHODS = ("auto", "modulating", "lock-in", "two-relay", "two-relay-delay")
PEERS = ("IDIM-LS", "velocity sweep")
# rows of axes.md whose friction the goals are for: 1–6, 8–10, 14, 15
GOALS = (
    "emps", "epos-screw", "epos-antibacklash", "epos-worm", "hsm150", "ur10e", "mx106", "erob", "puma",
    "vertical", "bench",
)  # fmt: skip
OTHERS = ("thesis-motor", "franka", "openarm", "tree")
# room and torque as a technician would give them; the watchdog bears with the slowest cycle
ROOM = {
    "bench": 40.0, "thesis-motor": 40.0, "vertical": 150.0, "emps": 0.6, "epos-screw": 600.0,
    "epos-antibacklash": 2000.0, "epos-worm": 1500.0, "hsm150": 150.0, "ur10e": 6.0, "franka": 10.0,
    "mx106": 6.0, "erob": 10.0, "puma": 150.0, "tree": 10.0, "openarm": 10.0,
}  # fmt: skip
TORQUE = {"epos-antibacklash": 0.0135}
WATCHDOG, WATCHDOG_CYCLES = 0.1, 12


@dataclass
class Outcome:
    """One run against the truth; errors in per cent, None where the number was not given."""

    axis: str
    cycle: float
    late: bool
    method: str
    error: dict[str, float | None] = field(default_factory=dict)
    covered: bool | None = None
    half_width: float | None = None
    verdict: str = ""
    periods: float = 0.0
    seconds: float = 0.0
    travel: float = 0.0
    refused: str = ""


def link_of(name: str, cycle: float, late: bool, extra: str = "") -> str:
    delay = {0.001: 0.002, 0.004: 0.002}.get(cycle, cycle)
    parts = [f"delay={delay}", "lag=0.0005"] if name != "tree" else [f"delay={delay}"]
    parts += [LATE] if late else []
    parts += [extra] if extra else []
    return f"virtual://{name}?" + "&".join(parts)


def truth_of(axis: VirtualAxis) -> dict[str, float]:
    return {
        "coulomb": axis.coulomb + axis.load_coulomb,
        "inertia": axis.inertia,
        "viscous": axis.viscous,
        "dead_time": axis.delay + axis.lag,
    }


def measure(
    link: str, cycle: float, method: str = "auto", travel: float | None = None
) -> RunResult:
    name = parse(link).place
    axis = axis_of(link)
    limits = axis.limits.model_copy(update={"watchdog": max(WATCHDOG, WATCHDOG_CYCLES * cycle)})
    axis = axis.model_copy(update={"limits": limits})
    with Journal(Path(os.environ["TWORELAY_HOME"])) as journal, Interruption() as interruption:
        desk = Desk(journal, interruption, lambda text: None, lambda question, word: True)
        options = Options(
            cycle=cycle, travel=travel or ROOM[name], method=method, max_torque=TORQUE.get(name)
        )
        return session.identify(axis, options, desk)


def run(case: tuple[str, float, bool, str]) -> Outcome:
    name, cycle, late, method = case
    outcome = Outcome(name, cycle, late, method)
    link = link_of(name, cycle, late)
    axis = configured(name, parse(link).options)
    truth = truth_of(axis)
    try:
        if method == "velocity sweep":
            return sweep(outcome, link, axis, truth)
        result = measure(link, cycle, "auto" if method == "IDIM-LS" else method)
    except Failure as failure:
        outcome.refused = str(failure.error)
        return outcome
    except Exception as bug:
        outcome.refused = f"BUG {type(bug).__name__}: {bug}"
        return outcome
    watched, coulomb = result.experiment, result.friction.coulomb
    assert watched is not None
    assert coulomb is not None
    outcome.periods, outcome.seconds = round(watched.periods), watched.duration
    outcome.travel, outcome.verdict = watched.travel, result.quality.verdict or ""
    if method == "IDIM-LS":
        return idim(outcome, result, truth)
    for key, value in truth.items():
        found = result.friction.quantity(key)
        outcome.error[key] = None if found is None or not value else 100 * (found.value / value - 1)
    low, high = coulomb.low or 0.0, coulomb.high or 0.0
    outcome.covered = low <= truth["coulomb"] <= high
    outcome.half_width = 50 * (high - low) / coulomb.value
    return outcome


def idim(outcome: Outcome, result: RunResult, truth: dict[str, float]) -> Outcome:
    """IDIM-LS on auto's own record."""
    folder = RunFolder(Path(os.environ["TWORELAY_HOME"]) / "runs" / str(result.run))
    samples = folder.samples()
    assert samples is not None
    assert result.experiment is not None
    first, second = result.experiment.cycles
    keep = (samples["time"] >= first.begin) & (samples["time"] <= second.end)
    time, y = samples["time"][keep], samples["position"][keep]
    record = Record.of(time, y, samples["sent"], samples["command"], 0.0)
    found = idim_numbers(record, first.period)
    for key, value in found.items():
        outcome.error[key] = 100 * (value / truth[key] - 1) if truth[key] else None
    return outcome


def idim_numbers(record: Record, period: float) -> dict[str, float]:
    """Inverse dynamic identification model with zero-phase filtering (Gautier).

    Position by a Butterworth filter forwards and backwards, velocity and acceleration by central
    differences, the same filter on the torque, least squares.
    """
    time = record.time
    step = float(np.median(np.diff(time)))
    grid = np.arange(time[0], time[-1], step)
    y = np.interp(grid, time, record.position)
    u = np.interp(grid, record.sent, record.command)
    cutoff = min(10 / period, 0.4 / step)  # ten times the fundamental
    b, a = butter(4, cutoff * 2 * step)
    smooth = filtfilt(b, a, y)
    speed = np.gradient(smooth, step)
    acceleration = np.gradient(speed, step)
    columns = np.column_stack((acceleration, speed, np.sign(speed), np.ones_like(speed)))
    filtered = np.column_stack([filtfilt(b, a, column) for column in columns.T])
    inner = slice(20, -20)
    solution, *_ = np.linalg.lstsq(filtered[inner], filtfilt(b, a, u)[inner], rcond=None)
    return dict(zip(("inertia", "viscous", "coulomb"), solution[:3].tolist(), strict=True))


def sweep(outcome: Outcome, link: str, axis: VirtualAxis, truth: dict[str, float]) -> Outcome:
    """A velocity sweep, and a straight line."""
    virtual = axis_of(link)
    limits = virtual.limits.model_copy(
        update={"watchdog": max(WATCHDOG, WATCHDOG_CYCLES * outcome.cycle)}
    )
    top = 0.25 * min(axis.speed, 4 * ROOM[axis.name])
    try:
        found, samples = _swept(virtual.model_copy(update={"limits": limits}), outcome.cycle, top)
    except ValueError as error:
        outcome.refused = str(error)
        return outcome
    outcome.seconds = samples[-1].time - samples[0].sent
    positions = [s.position for s in samples]
    outcome.travel = max(positions) - min(positions)
    for key in ("coulomb", "viscous"):
        value = getattr(found, key).value
        outcome.error[key] = 100 * (value / truth[key] - 1) if truth[key] else None
    return outcome


def swept(one: Case) -> float | None:
    """Error of f in per cent by a velocity sweep of an axis of the campaign; None: no number."""
    link = axis_of(one.link)
    limits = link.limits.model_copy(update={"watchdog": one.watchdog})
    axis = one.axis
    try:
        found, _ = _swept(link.model_copy(update={"limits": limits}), one.cycle, axis.speed / 16)
    except (ValueError, TwoRelayError):
        return None
    truth = (axis.coulomb + axis.load_coulomb) / axis.torque_gain
    return 100 * (found.coulomb.value / truth - 1)


def _swept(link: Axis, cycle: float, top: float) -> tuple[SteadyFit, list[Sample]]:
    """Constant speeds both ways in position mode, the drive's own torque.

    Raises ValueError where that is no friction curve.
    """
    drive = open_drive(link, cycle=cycle)
    points, samples = [], []
    try:
        for name, raw in drive.preparation.watchdog().items():
            drive.write(name, raw)
        drive.enable(Mode.POSITION, 0.0)
        goal = drive.read("position_actual").si
        for share in (0.1, 0.2, 0.4, 0.6, 0.8, 1.0):
            for direction in (1, -1):
                speed, torques = direction * share * top, []
                count = round(1.0 / cycle)
                for n in range(count):
                    goal += speed * cycle
                    sample = drive.exchange(goal)
                    samples.append(sample)
                    if not sample.status.enabled:
                        raise ValueError("the drive stopped: following error")
                    if n > count // 2:
                        torques.append(sample.torque)
                points.append(SteadyPoint(speed, float(np.mean(torques)), float(np.std(torques))))
    finally:
        drive.stop()
        drive.close()
    return fit(points), samples


def everything(pool: ProcessPoolExecutor) -> list[Outcome]:
    cases = [
        (name, cycle, late, method)
        for name in (*GOALS, *OTHERS)
        for cycle in CYCLES
        for late in (False, True)
        for method in (*METHODS, *PEERS)
    ]
    return list(pool.map(run, cases, chunksize=4))


# -- tables -------------------------------------------------------------------------------------------


def percent(value: float | None, digits: int = 2) -> str:
    return "–" if value is None else f"{value:+.{digits}f}"


def summary(outcomes: Iterable[Outcome], key: str) -> str:
    """Median and worst of the absolute errors, and how many gave no number."""
    rows = list(outcomes)
    found = [abs(e) for o in rows if (e := o.error.get(key)) is not None]
    if not found:
        return "–"
    missing = len(rows) - len(found)
    return f"{statistics.median(found):.2f} / {max(found):.2f}" + (
        f" ({missing} none)" if missing else ""
    )


def table(outcomes: list[Outcome]) -> list[str]:
    lines = [
        "# Every method on every axis",
        "",
        "Written by `make bench`. Errors in per cent against the virtual axis: median / worst of the absolute",
        "error over the axes and cycles of 1, 4, 10 and 20 ms, and how many runs gave no such number.",
        "Late: 10 % of the cycles late by an exponential time of mean one cycle, 2 % lost, exact stamps.",
        "Dead time: command delay 2 ms (10 and 20 ms at those cycles) and a torque lag of 0.5 ms.",
        "IDIM-LS: least squares with zero-phase filtering on auto's own record. Sweep: constant speeds in",
        "position mode. Each on the same virtual drive.",
        "",
    ]
    for title, names in (
        ("Axes 1–6, 8–10, 14, 15 of the bench", GOALS),
        ("The others: strongly damped, soft friction twice, series elastic", OTHERS),
    ):
        lines += [
            f"## {title}",
            "",
            "| method | late | f | J | B | dead time | periods | seconds | refused |",
            "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        ]
        for method in (*METHODS, *PEERS):
            for late in (False, True):
                rows = [
                    o for o in outcomes if o.axis in names and o.method == method and o.late is late
                ]
                done = [o for o in rows if not o.refused]
                cells = [summary(done, k) for k in ("coulomb", "inertia", "viscous", "dead_time")]
                periods = statistics.median(o.periods for o in done) if done else 0
                seconds = statistics.median(o.seconds for o in done) if done else 0
                lines.append(
                    f"| {method} | {'10 %' if late else 'none'} | "
                    + " | ".join(cells)
                    + f" | {periods:.0f} | {seconds:.1f} | {len(rows) - len(done)} of {len(rows)} |"
                )
        lines.append("")
    lines += _auto_periods(outcomes)
    lines += _per_axis(outcomes)
    return lines


def _auto_periods(outcomes: list[Outcome]) -> list[str]:
    auto = [o for o in outcomes if o.method == "auto" and o.axis in GOALS and not o.refused]
    short = sum(o.periods <= 12 for o in auto)
    middle = sum(12 < o.periods <= 30 for o in auto)
    return [
        f"auto, periods from rest: at most 12 in {short} of {len(auto)} runs, at most 30 in {middle} more,",
        f"beyond in {len(auto) - short - middle} (where the first look had chosen the torque wrongly).",
        "",
    ]


def _per_axis(outcomes: list[Outcome]) -> list[str]:
    lines = [
        "## auto, error of f by axis and cycle, none late / 10 % late",
        "",
        "| axis | "
        + " | ".join(f"{c * 1000:g} ms" for c in CYCLES)
        + " | travel used | interval covers |",
        "| --- |" + " --- |" * (len(CYCLES) + 2),
    ]
    for name in (*GOALS, *OTHERS):
        rows = [o for o in outcomes if o.axis == name and o.method == "auto"]
        cells = []
        for cycle in CYCLES:
            pair = [o for o in rows if o.cycle == cycle]
            cells.append(
                " / ".join("refused" if o.refused else percent(o.error["coulomb"]) for o in pair)
            )
        done = [o for o in rows if not o.refused]
        travel = max((o.travel for o in done), default=0.0)
        unit = "m" if AXES[name].motion == "linear" else "rad"
        covered = sum(bool(o.covered) for o in done)
        lines.append(
            f"| {name} | "
            + " | ".join(cells)
            + f" | {travel:.3g} {unit} | {covered} of {len(done)} |"
        )
    reasons = sorted(
        {f"{o.axis} {o.cycle * 1000:g} ms, {o.method}: {o.refused}" for o in outcomes if o.refused}
    )
    lines += ["", f"Refused runs ({len(reasons)}), each with its reason:", ""]
    lines += [f"- {reason[:230]}" for reason in reasons]
    return [*lines, ""]


def methods() -> list[str]:
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(
            max_workers=os.cpu_count(), initializer=_home, initargs=(folder,)
        ) as pool,
    ):
        return table(everything(pool))


def _home(folder: str) -> None:
    os.environ["TWORELAY_HOME"] = str(Path(folder) / str(os.getpid()))
