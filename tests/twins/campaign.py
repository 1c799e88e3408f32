"""Random axes of ten kinds are measured, and their twins again: `python -m tests.twins.campaign`.

Every number of the twin's run must lie within 1 % of the run it was made of, or within the interval
of either. Its points of the plant, too: where a relay settles depends on how it was set, so a point
is compared with the plant of the first run at its own frequency, and a point at a phase by what its
phase may be off, too. Ends with "twins: N axes, M held".
"""

from __future__ import annotations

import cmath
import os
import random
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import pi, radians
from pathlib import Path

from commissioning.journal import Journal
from commissioning.result.document import RunResult
from commissioning.result.found import QUANTITIES, Point, Quantity
from commissioning.runs import resolve
from drivers.home import home
from tests.command import in_this_process
from tests.serving import serve

__all__ = ["KINDS", "Case", "cases", "deviations", "measured_twice"]

_SHARE = 0.01
_POINTS = "corrected", "measured", "at_180", "at_135"  # the others are wrong on purpose
Draw = Callable[[random.Random], tuple[str, str]]  # options, and lines of an axis file


def _plain(draw: random.Random) -> dict[str, float]:
    """A rotary axis of some rated torque."""
    rated = 10 ** draw.uniform(-0.5, 1.5)
    inertia = 1e-3 * rated * 10 ** draw.uniform(-0.5, 0.5)
    return {
        "rated": rated, "peak": 3 * rated, "inertia": inertia,
        "coulomb": rated * draw.uniform(0.05, 0.25), "viscous": inertia * draw.uniform(0.5, 4),
        "delay": draw.uniform(0.0015, 0.004), "seed": draw.randrange(1000),
    }  # fmt: skip


def _with(**more: Callable[[random.Random, dict[str, float]], float]) -> Draw:
    def made(draw: random.Random) -> tuple[str, str]:
        options = _plain(draw)
        for name, value in more.items():
            options[name] = value(draw, options)
        return _text(options), "travel = 20\n"

    return made


def _text(options: dict[str, float]) -> str:
    return "&".join(f"{name}={value:.6g}" for name, value in options.items())


def _geared(draw: random.Random) -> tuple[str, str]:
    return _text(_plain(draw)), f"travel = 0.4\n[mechanics]\ngear = {draw.choice((5, 8.5, 12))}\n"


def _linear(draw: random.Random) -> tuple[str, str]:
    feed = draw.choice((0.01, 0.02, 0.12))
    lines = f'travel = {feed / 2}\n[mechanics]\nmotion = "linear"\nfeed = {feed}\n'
    return _text(_plain(draw)), lines


KINDS: dict[str, Draw] = {
    "rigid": _with(),
    "gravity": _with(load=lambda r, o: o["rated"] * r.uniform(-0.15, 0.15)),
    "directions": _with(asymmetry=lambda r, o: r.uniform(-0.1, 0.1)),
    "stribeck": _with(
        breakaway=lambda r, o: o["coulomb"] * r.uniform(1.15, 1.4),
        stribeck=lambda r, o: r.uniform(0.5, 3),
    ),
    "soft": _with(
        inertia=lambda r, o: o["rated"] * r.uniform(0.01, 0.02),
        coulomb=lambda r, o: o["rated"] * r.uniform(0.04, 0.06),
        viscous=lambda r, o: o["inertia"] * r.uniform(0.1, 1),
        soft=lambda r, o: r.uniform(0.15, 0.25),
    ),
    "viscous": _with(viscous=lambda r, o: o["inertia"] * r.uniform(8, 25)),
    "much friction": _with(coulomb=lambda r, o: o["rated"] * r.uniform(0.25, 0.3)),
    "slow torque": _with(lag=lambda r, o: r.uniform(0.0003, 0.001)),
    "geared": _geared,
    "linear": _linear,
}


@dataclass(frozen=True, slots=True)
class Case:
    """An axis to be measured."""

    kind: str
    number: int
    options: str
    lines: str


def cases(count: int) -> Iterator[Case]:
    """`count` axes, kind by kind in turn."""
    names = list(KINDS)
    for number in range(count):
        kind = names[number % len(names)]
        yield Case(kind, number, *KINDS[kind](random.Random(number)))


def _identified(axis: Path) -> RunResult:
    done = in_this_process("identify", str(axis), "--yes")
    assert done.returncode == 0, done.stderr
    with Journal(home(), reading=True) as journal:
        return resolve(journal, "last")[1].result()


def measured_twice(case: Case, folder: Path) -> tuple[RunResult, RunResult]:
    """What the axis measures, and what its twin does."""
    axis, twin = folder / "axis.toml", folder / "twin.toml"
    wire = "--modbus-tcp", "127.0.0.1:0", "--clock", "step"
    with serve(f"bench?{case.options}", *wire) as (link,):
        axis.write_text(f'link = "{link}"\n{case.lines}', "utf-8")
        first = _identified(axis)
    with serve("--from", str(first.run), *wire, "--axis-file", str(twin)):
        return first, _identified(twin)


# -- how far they are apart -----------------------------------------------------------------------


def deviations(first: RunResult, second: RunResult) -> Iterator[tuple[str, float, bool]]:
    """Name, share of the value, and whether it holds, of each number of the first run."""
    for name in QUANTITIES:
        one, other = first.friction.quantity(name), second.friction.quantity(name)
        if one is not None:
            yield name, *_number(one, other)
    if first.critical_point is None or second.critical_point is None:
        return
    for name in _POINTS:
        point, there = first.critical_point.point(name), second.critical_point.point(name)
        if point is not None:
            yield f"{name} gain", *_at(first, point, there)


def _number(one: Quantity, other: Quantity | None) -> tuple[float, bool]:
    if other is None:
        return float("inf"), False
    share = abs(other.value - one.value) / abs(one.value) if one.value else float("inf")
    within = _inside(other.value, one.low, one.high) or _inside(one.value, other.low, other.high)
    return share, share <= _SHARE or within


def _at(first: RunResult, one: Point, other: Point | None) -> tuple[float, bool]:
    """Deviation of the twin's point from the first run's plant at its frequency."""
    if other is None:
        return float("inf"), False
    found = first.friction
    known = [found.quantity(name) for name in ("inertia", "viscous", "dead_time")]
    if None in known:
        return 0.0, True  # no plant to compare it with
    inertia, viscous, dead_time = (q.value for q in known if q is not None)

    def plant(period: float) -> complex:
        s = 2j * pi / period
        return cmath.exp(-s * dead_time) / (inertia * s**2 + viscous * s)

    def value(point: Point) -> complex:
        return cmath.rect(point.gain, radians(point.phase_deg))

    moved = value(one) / plant(one.period) * plant(other.period)
    share = abs(value(other) / moved - 1)
    error = sum(_error(point) for point in (one, other))
    return share, share <= max(_SHARE, error)


def _error(point: Point) -> float:
    """What a point may be off, as a share."""
    if point.gain_high is None or point.phase_high_deg is None:
        return 0.0
    return point.gain_high / point.gain - 1 + radians(point.phase_high_deg - point.phase_deg)


def _inside(value: float, low: float | None, high: float | None) -> bool:
    return low is not None and high is not None and low <= value <= high


def main() -> int:
    """Measure; returns 1 where a twin differs."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 40
    only = sys.argv[2] if len(sys.argv) > 2 else ""
    held = 0
    worst: dict[str, float] = {}
    chosen = [case for case in cases(count) if only in case.kind]
    for case in chosen:
        with tempfile.TemporaryDirectory() as folder:
            os.environ["TWORELAY_HOME"] = str(Path(folder) / "home")
            try:
                pair = measured_twice(case, Path(folder))
            except AssertionError as error:
                print(f"{case.kind} {case.number}: {str(error).strip()[:300]} {case.options}")  # noqa: T201
                continue
        found = list(deviations(*pair))
        bad = [f"{name} {100 * share:.2g} %" for name, share, holds in found if not holds]
        held += not bad
        for name, share, _ in found:
            if name != "offset":
                worst[name] = max(worst.get(name, 0.0), share)
        figures = ", ".join(f"{name} {100 * share:.2g} %" for name, share, _ in found)
        print(f"{case.kind} {case.number} {pair[0].quality.verdict}: {figures}", *bad, sep="  ! ")  # noqa: T201
    print("largest:", ", ".join(f"{name} {100 * share:.2g} %" for name, share in worst.items()))  # noqa: T201
    print(f"twins: {len(chosen)} axes, {held} held")  # noqa: T201
    return int(held != len(chosen))


if __name__ == "__main__":
    sys.exit(main())
