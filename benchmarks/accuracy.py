"""make accuracy [SEED=N]: random axes of every class, closed loop, against the truth.

40 axes a class, measured as a technician would, and by what an engineer would use instead. A call
goes on where the last one ended, for about nine minutes; `.accuracy/` keeps what is known. Without
a seed the unfinished campaign goes on, or a new seed is drawn. Ends with "accuracy: N of M axes".
"""

from __future__ import annotations

import cmath
import json
import math
import os
import random
import statistics
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as many processes as processors are at work
HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

import numpy as np  # noqa: E402

from benchmarks.bound import coulomb_bound  # noqa: E402
from benchmarks.classes import CLASSES, RIGID, Case, case  # noqa: E402
from benchmarks.critical_point import compared, plant_of  # noqa: E402
from benchmarks.methods import idim_numbers, swept  # noqa: E402
from commissioning.desk import Desk, Options  # noqa: E402
from commissioning.identification.modulating import estimate  # noqa: E402
from commissioning.identification.output_error import output_error  # noqa: E402
from commissioning.identification.record import Record, reversals  # noqa: E402
from commissioning.identification.segments import segments_of  # noqa: E402
from commissioning.interruption import Interruption  # noqa: E402
from commissioning.journal import Journal  # noqa: E402
from commissioning.result.document import RunResult  # noqa: E402
from commissioning.result.found import Point  # noqa: E402
from commissioning.rig import methods as rig_methods  # noqa: E402
from commissioning.rig import mover, precise  # noqa: E402
from commissioning.rig.armed import Failure  # noqa: E402
from commissioning.session import identify as session  # noqa: E402
from drivers.link import axis_of  # noqa: E402
from drivers.virtual import compliant_plant  # noqa: E402
from drivers.virtual.axes import VirtualAxis  # noqa: E402
from drivers.virtual.plant import PlantParameters  # noqa: E402

KNOWN = HERE.parent / ".accuracy"
AXES, MINUTES = 40, 9.0
PRECISION = float(os.environ.get("PRECISION", "0.01"))  # as --precision
ASKED = 0.01  # … by default, of which the table is
NUMBERS = ("coulomb", "inertia", "viscous", "offset", "dead_time")
POINTS = ("corrected", "measured", "at_180", "at_135")
COLUMNS = (
    "good / usable / refused", "f", "J", "B", "offset", "dead time", "interval true (in this order)", "half-width",
    "lies", "bound", "periods", "s of motion", "s of analysis", "simulated s a second", "IDIM-LS",
    "sweep",
)  # fmt: skip
LIE = 3.0  # %: a `good` result that is off by more
# where it is the friction of a linear plant on the measured side
LINEAR = (*RIGID, "fine stamps", "stamps", "load", "drift", "drag", "twomass", "belt", "stiff")


@dataclass
class Outcome:
    """One axis against the truth; errors in per cent of the truth, offset in per cent of friction."""

    kind: str
    number: int
    link: str
    verdict: str = ""  # '' : refused
    why: str = ""
    error: dict[str, float] = field(default_factory=dict)
    covered: dict[str, bool] = field(default_factory=dict)  # the truth, by the interval
    half_width: float | None = None
    periods: int = 0
    moving: float = 0.0  # s of the axis
    analysis: float = 0.0  # s of the processor
    speed: float = 0.0  # simulated seconds a second
    left: tuple[float, float] | None = None  # held-out residual and noise, of the torque
    bound: float | None = None  # |error| of f over its Cramér–Rao bound
    points: dict[str, tuple[float, float, bool | None]] = field(default_factory=dict)
    peers: dict[str, float | None] = field(default_factory=dict)


# -- one axis -----------------------------------------------------------------------------------------


def measured(one: Case) -> Outcome:
    """Measure an axis of the campaign; a refusal is an outcome, a bug is told as one."""
    outcome = Outcome(one.kind, one.number, one.link)
    moving: list[float] = []
    original = vars(mover)["run"]

    def timed(*arguments: Any, **keywords: Any) -> Any:
        begin = time.process_time()
        try:
            return original(*arguments, **keywords)
        finally:
            moving.append(time.process_time() - begin)

    records: list[tuple[Record, Sequence[tuple[float, float]]]] = []

    def kept(record: Record, **keywords: Any) -> Any:
        records.append((record, ()))
        return estimate(record, **keywords)

    def fitted(record: Record, *start: Any, spans: Any = (), **keywords: Any) -> Any:
        found = output_error(record, *start, spans=spans, **keywords)
        if found.is_explained:  # else another method reads another record
            records.append((record, spans))
        return found

    with (
        tempfile.TemporaryDirectory() as folder,
        patch.object(mover, "run", timed),
        patch.object(rig_methods, "estimate", kept),
        patch.object(precise, "output_error", fitted),
    ):
        begin = time.process_time()
        try:
            result = _identified(one, Path(folder))
        except Failure as failure:
            outcome.why = str(failure.error)
            _refused(outcome, failure.result)
            return outcome
        except Exception as bug:
            outcome.why = f"BUG {type(bug).__name__}: {bug}"
            return outcome
        outcome.analysis = time.process_time() - begin - sum(moving)
    assert result.experiment is not None
    outcome.speed = result.experiment.duration / max(sum(moving), 1e-9)
    record, spans = records[-1]  # what the numbers are of
    _compare(outcome, result, record, spans)
    outcome.peers["IDIM-LS"] = _error(
        idim_numbers(
            record.between(*spans[-1]) if spans else record, result.experiment.cycles[0].period
        )["coulomb"],
        one.axis,
    )
    outcome.peers["sweep"] = swept(one)
    return outcome


def _identified(one: Case, home: Path) -> RunResult:
    axis = axis_of(one.link)
    limits = axis.limits.model_copy(update={"watchdog": one.watchdog})
    with Journal(home) as journal, Interruption() as interruption:
        desk = Desk(journal, interruption, lambda text: None, lambda question, word: True)
        options = Options(cycle=one.cycle, travel=one.travel, precision=PRECISION)
        return session.identify(axis.model_copy(update={"limits": limits}), options, desk)


def _refused(outcome: Outcome, result: RunResult | None) -> None:
    if result is not None and result.experiment is not None:
        outcome.periods = round(result.experiment.periods)
        outcome.moving = result.experiment.duration


def _compare(
    outcome: Outcome, result: RunResult, record: Record, spans: Sequence[tuple[float, float]]
) -> None:
    axis, watched = case_of(outcome).axis, result.experiment
    assert watched is not None
    assert result.friction.coulomb is not None
    outcome.verdict = str(result.quality.verdict)
    outcome.periods, outcome.moving = round(watched.periods), watched.duration
    outcome.why = "; ".join(r.code for r in result.quality.reasons if r.weight != "note")
    reading = result.methods.modulating if result.methods else None
    if reading is not None:
        outcome.left = (reading.held_out or 0.0, reading.noise or 0.0)
    middle = float(record.time.mean())
    if result.friction.method == "output-error":
        middle = segments_of(record, None, spans).middle + float(record.time[0])
    truth = truth_of(axis, record, middle)
    found = result.friction.coulomb
    for name, value in truth.items():
        number = result.friction.quantity(name)
        if number is not None and value is not None:
            if number.low is not None and number.high is not None:
                outcome.covered[name] = bool(number.low <= value <= number.high)
            scale = truth["coulomb"] if name == "offset" else value
            assert scale is not None
            if scale:
                outcome.error[name] = 100 * (number.value - value) / scale
    f = truth["coulomb"]
    assert f is not None
    assert found.low is not None
    assert found.high is not None
    outcome.half_width = 50 * (found.high - found.low) / found.value
    if outcome.kind in RIGID:
        outcome.bound = abs(found.value - f) / bound_of(axis, record, f, spans)
    if outcome.kind in LINEAR and result.critical_point is not None:
        for name in POINTS:
            point = result.critical_point.point(name)
            if point is not None:
                outcome.points[name] = against_plant(point, axis)
            if point is not None and point.ku is not None and name == "at_180":
                truth_ku = ku_of(axis, 2 * math.pi / point.period)
                held = None
                if point.ku_low is not None and point.ku_high is not None and truth_ku:
                    held = bool(point.ku_low <= truth_ku <= point.ku_high)
                if truth_ku:
                    outcome.points["ku"] = (100 * (point.ku / truth_ku - 1), 0.0, held)


def case_of(outcome: Outcome) -> Case:
    return Case(outcome.kind, outcome.number, outcome.link, 0.0, 0.0, 0.0)


def truth_of(axis: VirtualAxis, record: Record, middle: float) -> dict[str, float | None]:
    """What is right, in units of the commanded torque; None where a number has no one meaning."""
    f = axis.coulomb + axis.load_coulomb
    if axis.drift:  # the mean over the samples used
        f *= 1 + axis.drift * middle
    if axis.position_slope or axis.position_wave:
        x = record.position
        wave = axis.position_wave * np.sin(2 * np.pi * x / axis.position_pitch)
        f *= float(np.mean(1 + axis.position_slope * x + wave))
    gain = axis.torque_gain
    # a lag delays by what the phase at the record's own frequency says
    w = math.pi / float(np.median(np.diff(reversals(record)[0])))
    uneven = axis.gravity or axis.spring or axis.position_slope or axis.position_wave
    return {
        "coulomb": f / gain,
        "inertia": axis.inertia / gain,
        "viscous": (axis.viscous / gain) if axis.viscous else None,
        "offset": None if uneven else (axis.load + f * axis.asymmetry) / gain,
        "dead_time": axis.delay + math.atan(w * axis.lag) / w + axis.tick,
    }


def _error(value: float | None, axis: VirtualAxis) -> float | None:
    f = (axis.coulomb + axis.load_coulomb) / axis.torque_gain
    return None if value is None else 100 * (value / f - 1)


def bound_of(
    axis: VirtualAxis, record: Record, f: float, spans: Sequence[tuple[float, float]]
) -> float:
    noise = math.sqrt(axis.resolution**2 / 12 + axis.noise**2)
    offset = axis.load + axis.coulomb * axis.asymmetry
    truth = PlantParameters(axis.inertia, axis.viscous, f, f, offset, lag=axis.lag)
    return coulomb_bound(record, truth, axis.delay, noise, spans)


def against_plant(point: Point, axis: VirtualAxis) -> tuple[float, float, bool | None]:
    """Errors of gain (%) and phase (°) at the point's own frequency, and whether it is covered."""
    gain, turned, _, covered = compared(point, axis)
    return gain, turned, None if covered is None else bool(covered)


def ku_of(axis: VirtualAxis, near: float) -> float | None:
    """The true ultimate gain: 1/|G| where the phase crosses −180° next to `near`, rad/s."""
    w = near * np.geomspace(0.2, 5, 20_001)
    turned = np.array([cmath.phase(-plant_of(axis, x)) for x in w])
    small = np.abs(turned) < 0.5 * np.pi
    crossed = np.flatnonzero((turned[:-1] * turned[1:] <= 0) & small[:-1] & small[1:])
    if not len(crossed):
        return None
    at = crossed[np.argmin(np.abs(np.log(w[crossed] / near)))]
    return 1 / abs(plant_of(axis, float(w[at])))


# -- the campaign -------------------------------------------------------------------------------------


def _home() -> None:
    compliant_plant.accelerate()


def state_file(seed: int) -> Path:
    return KNOWN / (f"{seed}.jsonl" if PRECISION == ASKED else f"{seed}-{PRECISION:g}.jsonl")


def known(seed: int) -> dict[tuple[str, int], Outcome]:
    path = state_file(seed)
    found = {}
    if path.exists():
        for line in path.read_text("utf-8").splitlines():
            outcome = Outcome(**json.loads(line))
            found[outcome.kind, outcome.number] = outcome
    return found


def seed_to_use(asked: str) -> int:
    if asked:
        return int(asked)
    for path in sorted(KNOWN.glob("*.jsonl"), key=lambda p: p.stat().st_mtime, reverse=True):
        seed = int(path.stem.split("-")[0])
        if seed > 9 and len(known(seed)) < AXES * len(CLASSES):
            return seed
    return random.SystemRandom().randrange(10, 1_000_000)  # 1–9 are for tuning


def go_on(
    seed: int, kinds: Sequence[str], axes: int, minutes: float
) -> dict[tuple[str, int], Outcome]:
    """Measure what is not known yet, as far as the time allows."""
    KNOWN.mkdir(exist_ok=True)
    have = known(seed)
    todo = [case(k, seed, n) for n in range(axes) for k in kinds if (k, n) not in have]
    end, total = time.monotonic() + 60 * minutes, len(todo)
    with (
        state_file(seed).open("a", encoding="utf-8") as file,
        ProcessPoolExecutor(os.cpu_count(), initializer=_home) as pool,
    ):
        waiting = [pool.submit(measured, one) for one in todo]
        for done, future in enumerate(waiting, 1):
            if time.monotonic() > end:
                pool.shutdown(wait=True, cancel_futures=True)
                for late in waiting[done - 1 :]:
                    if late.done() and not late.cancelled():
                        _keep(late.result(), have, file)
                break
            _keep(future.result(), have, file)
            if done % 20 == 0:
                print(f"{done} of {total} axes", file=sys.stderr, flush=True)
    return have


def _keep(outcome: Outcome, have: dict[tuple[str, int], Outcome], file: Any) -> None:
    have[outcome.kind, outcome.number] = outcome
    file.write(json.dumps(asdict(outcome), default=float) + "\n")
    file.flush()


# -- tables -------------------------------------------------------------------------------------------


def spread(values: Iterable[float], digits: int = 2) -> str:
    """Median / 95 % / worst of the sizes."""
    sizes = sorted(abs(v) for v in values)
    if not sizes:
        return "–"
    at = sizes[min(math.ceil(0.95 * len(sizes)) - 1, len(sizes) - 1)]
    return " / ".join(f"{v:.{digits}f}" for v in (statistics.median(sizes), at, sizes[-1]))


def row(kind: str, mine: list[Outcome]) -> str:
    given = [o for o in mine if o.verdict]
    good = [o for o in given if o.verdict == "good"]
    verdicts = f"{len(good)} / {len(given) - len(good)} / {len(mine) - len(given)}"
    errors = [
        spread((o.error[n] for o in given if n in o.error), 4 if n == "coulomb" else 3)
        for n in NUMBERS
    ]
    told = [[o.covered[n] for o in given if n in o.covered] for n in NUMBERS]
    covered = " ".join(f"{sum(held)}/{len(held)}" for held in told)
    width = f"{statistics.median(o.half_width or 0.0 for o in given):.3f}" if given else "–"
    lies = sum(abs(o.error["coulomb"]) > LIE for o in good)
    bound = spread((o.bound for o in given if o.bound is not None), 1) if kind in RIGID else "–"
    middle = [
        f"{statistics.median(value):.{digits}f}" if value else "–"
        for value, digits in (
            ([o.periods for o in given], 0), ([o.moving for o in given], 0),
            ([o.analysis for o in given], 2), ([o.speed for o in given], 0),
        )
    ]  # fmt: skip
    peers = [
        spread((v for o in given if (v := o.peers.get(name)) is not None), 0)
        for name in ("IDIM-LS", "sweep")
    ]
    cells = [kind, verdicts, *errors, covered, width, str(lies), bound, *middle, *peers]
    return "| " + " | ".join(cells) + " |"


def table(seed: int, outcomes: list[Outcome], axes: int) -> list[str]:
    asked = "" if PRECISION == ASKED else f"PRECISION={PRECISION:g} "
    lines = [
        "# Accuracy",
        "",
        f"Written by `{asked}AXES={axes} make accuracy SEED={seed}`: {axes} random axes of every class ({len(outcomes)} in all),",
        f"each measured with `--precision {100 * PRECISION:g}%`,",
        "as a technician would, friction and all else unknown. The seed was drawn by the program.",
        "Errors in per cent of the truth (offset: of the friction), median / 95 % / worst, of what was given.",
        "Torque and friction are in units of the commanded torque. `lies`: `good` results off by more than 3 %.",
        "Bound: error of f over its Cramér–Rao bound (J, B, f, offset, dead time, lag and one initial state",
        "unknown). Peers: error of f of IDIM-LS on the same record, and of a sweep of constant speeds.",
        "",
        "| class | " + " | ".join(COLUMNS) + " |",
        "| --- |" + " --- |" * 16,
    ]
    by_kind = {kind: [o for o in outcomes if o.kind == kind] for kind in CLASSES}
    lines += [row(kind, mine) for kind, mine in by_kind.items() if mine]
    rigid = [o for o in outcomes if o.kind in RIGID]
    lines += [
        row("**rigid classes**", rigid).replace("| – | ", "| – | ", 1),
        row("**all**", outcomes),
    ]
    lines += ["", "## Points of the plant, linear classes", "", *_points(outcomes)]
    lines += ["", "## Why refused", "", *_reasons(outcomes)]
    return lines


def _points(outcomes: list[Outcome]) -> list[str]:
    lines = [
        "Gain in per cent and phase in degrees against the true plant at the point's own frequency.",
        "",
        "| point | gain | phase | interval true |",
        "| --- | --- | --- | --- |",
    ]
    for name in (*POINTS, "ku"):
        found = [o.points[name] for o in outcomes if name in o.points]
        told = [p[2] for p in found if p[2] is not None]
        lines.append(
            f"| {name} | {spread(p[0] for p in found)} | {spread(p[1] for p in found)} | "
            f"{sum(told)} of {len(told)} |"
        )
    return lines


def _reasons(outcomes: list[Outcome]) -> list[str]:
    counted: dict[str, list[str]] = {}
    for o in outcomes:
        if not o.verdict:
            words = " ".join(w for w in o.why.split() if not any(c.isdigit() for c in w))
            counted.setdefault(words[:90], []).append(o.kind)
    return [
        f"- {len(kinds)} × {text} … ({', '.join(sorted(set(kinds)))})"
        for text, kinds in sorted(counted.items(), key=lambda item: -len(item[1]))
    ]


def main() -> None:
    seed = seed_to_use(os.environ.get("SEED", ""))
    axes = int(os.environ.get("AXES", str(AXES)))
    kinds = [k for k in os.environ.get("CLASSES", "").split(",") if k] or list(CLASSES)
    minutes = float(os.environ.get("MINUTES", str(MINUTES)))
    print(f"seed {seed}", file=sys.stderr, flush=True)
    have = go_on(seed, kinds, axes, minutes)
    mine = [o for (kind, number), o in sorted(have.items()) if kind in kinds and number < axes]
    text = "\n".join(table(seed, mine, axes)) + "\n"
    complete = len(mine) == axes * len(CLASSES if PRECISION == ASKED else kinds)
    name = "accuracy.md" if PRECISION == ASKED else "accuracy_at_most.md"
    (HERE / name if complete else KNOWN / f"{seed}.md").write_text(text, "utf-8")
    print(text)
    print(f"accuracy: {len(mine)} of {axes * len(kinds)} axes")


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit("accuracy: stopped; what is known is kept, and the next call goes on from there")
