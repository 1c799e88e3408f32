"""make bench: measure, and write the tables beside this file; with names of tables, those."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import patch

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from benchmarks.critical_point import critical_point  # noqa: E402
from benchmarks.drift import drift  # noqa: E402
from benchmarks.fleet import fleet  # noqa: E402
from benchmarks.gateways import gateways  # noqa: E402
from benchmarks.history import history  # noqa: E402
from benchmarks.links import WIRES, links, served  # noqa: E402
from benchmarks.methods import methods  # noqa: E402
from benchmarks.panel import panel  # noqa: E402
from benchmarks.plants import plants  # noqa: E402
from benchmarks.stop_times import stop_times  # noqa: E402
from benchmarks.units import units  # noqa: E402
from commissioning.desk import Desk, Options  # noqa: E402
from commissioning.interruption import Interruption  # noqa: E402
from commissioning.journal import Journal  # noqa: E402
from commissioning.result.document import RunResult  # noqa: E402
from commissioning.rig import methods as rig_methods  # noqa: E402
from commissioning.rig import mover, precise  # noqa: E402
from commissioning.session import identify as session  # noqa: E402
from drivers.link import axis_of  # noqa: E402


def measure(
    link: str, cycle: float, travel: float | None = None, method: str = "auto"
) -> RunResult:
    with Journal(Path(os.environ["TWORELAY_HOME"])) as journal, Interruption() as interruption:
        desk = Desk(journal, interruption, lambda text: None, lambda question, word: True)
        options = Options(cycle=cycle, travel=travel, method=method)
        return session.identify(axis_of(link), options, desk)


def error_of(result: RunResult, truth: float) -> str:
    assert result.friction.coulomb is not None
    return f"{100 * (result.friction.coulomb.value / truth - 1):+.2f} %"


def wires() -> list[str]:
    """Error of f on `bench` over every wire, and in process beside it."""
    cycles = (0.002, 0.005)
    lines = [
        "# The same axis over every wire",
        "",
        "Written by `make bench`: error of the Coulomb friction of `bench` by `auto` and by `two-relay`",
        "(4.16), `clock=step`.",
        "",
        "| link | "
        + " | ".join(f"auto, {c * 1000:g} ms | two-relay, {c * 1000:g} ms" for c in cycles)
        + " |",
        "| --- |" + " --- |" * (2 * len(cycles)),
    ]
    for name, arguments in {"in process": None, **WIRES}.items():
        cells = []
        for cycle in cycles:
            for method in ("auto", "two-relay"):
                if arguments is None:
                    cells.append(error_of(measure("virtual://bench", cycle, None, method), 0.1))
                    continue
                with served(*arguments, "--clock", "step") as link:
                    cells.append(error_of(measure(link, cycle, 3.14, method), 0.1))
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return lines


def timed(action: Callable[[], Any], repeat: int = 5) -> float:
    """Best of some runs, s."""
    times = []
    for _ in range(repeat):
        begin = time.perf_counter()
        action()
        times.append(time.perf_counter() - begin)
    return min(times)


def side_by_side(*actions: Callable[[], Any], repeat: int) -> list[float]:
    """Median time of each, in turn, so that the machine's moods meet all alike, s."""
    times: list[list[float]] = [[] for _ in actions]
    for _ in range(repeat):
        for action, found in zip(actions, times, strict=True):
            begin = time.perf_counter()
            action()
            found.append(time.perf_counter() - begin)
    return [statistics.median(found) for found in times]


def command(*arguments: str) -> Callable[[], None]:
    def run() -> None:
        subprocess.run(
            [sys.executable, *arguments], check=True, capture_output=True, cwd=HERE.parent
        )

    return run


def speed() -> list[str]:
    """How fast the loop is, and what the command line costs."""
    link = "virtual://bench"
    spent: list[tuple[float, int]] = []
    original = vars(mover)["run"]

    def counted(*arguments: Any, **keywords: Any) -> Any:
        recorder = arguments[3]
        before, begin = len(recorder.samples), time.perf_counter()
        try:
            return original(*arguments, **keywords)
        finally:
            spent.append((time.perf_counter() - begin, len(recorder.samples) - before))

    rates = []
    with patch.object(mover, "run", counted):
        for _ in range(7):
            spent.clear()
            measure(link, 0.001)
            rates.append(sum(n for _, n in spent) * 0.001 / sum(s for s, _ in spent))
    whole = timed(lambda: measure(link, 0.001))
    watched = measure(link, 0.001).experiment
    assert watched is not None
    duration = watched.duration
    tworelay = str(Path(sys.executable).parent / "tworelay")
    click_alone, help_time = side_by_side(
        command("-c", "import click"),
        lambda: subprocess.run([tworelay, "--help"], check=True, capture_output=True),
        repeat=15,
    )
    numbers, identify_time = side_by_side(
        command("-c", "import numpy, scipy.optimize"),
        command("-m", "commissioning", "identify", link, "--yes"),
        repeat=5,
    )
    return [
        "# Speed",
        "",
        "Written by `make bench`; a shared machine, so compare within one run.",
        "",
        "| | |",
        "| --- | --- |",
        f"| simulated seconds a second, `virtual://bench` at 1 ms, whole loop | {statistics.median(rates):.0f} (best {max(rates):.0f}) |",
        f"| the job in process: {duration:.1f} simulated seconds in | {whole * 1000:.0f} ms |",
        *methods_side_by_side(link),
        f"| `tworelay identify virtual://bench --yes`, wall time | {identify_time:.2f} s |",
        f'| … over `python -c "import numpy, scipy.optimize"` | {identify_time / numbers:.1f} × |',
        f"| `tworelay --help` | {help_time * 1000:.0f} ms |",
        f'| … over `python -c "import click"` | {help_time / click_alone:.2f} × |',
    ]


def methods_side_by_side(link: str) -> list[str]:
    """Output error to the default precision beside the dozen periods of modulating functions."""
    fits: dict[str, tuple[ModuleType, str]] = {
        "output-error": (precise, "output_error"), "modulating": (rig_methods, "estimate"),
    }  # fmt: skip
    spent: dict[str, list[float]] = {name: [] for name in fits}
    moved, whole = {}, {}
    for _ in range(5):
        for method, (module, name) in fits.items():
            original = vars(module)[name]

            def counted(*arguments: Any, to: str = method, fit: Any = original, **rest: Any) -> Any:
                begin = time.perf_counter()
                found = fit(*arguments, **rest)
                spent[to].append(time.perf_counter() - begin)
                return found

            with patch.object(module, name, counted):
                watched = measure(link, 0.001, None, method).experiment
            assert watched is not None
            whole[method] = watched.duration
            moved[method] = sum(end - begin for begin, end in watched.analysed)
    fit = {method: min(times) for method, times in spent.items()}
    new, old = fits
    return [
        f"| analysis by output error, {1000 * fit[new]:.0f} ms, over modulating functions | {fit[new] / fit[old]:.2f} × |",
        f"| oscillating to ±1 %: {moved[new]:.2f} s of {moved[old]:.2f} s that a dozen periods take | {moved[new] / moved[old]:.2f} × |",
        f"| … with the first motions: {whole[new]:.2f} s of {whole[old]:.2f} s | {whole[new] / whole[old]:.2f} × |",
    ]


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        os.environ["TWORELAY_HOME"] = folder
        tables: dict[str, Callable[[], list[str]]] = {
            "wires": wires, "speed": speed, "links": links, "critical_point": critical_point, "units": units,
            "stop_times": stop_times, "fleet": fleet, "history": history,
            "drift": drift, "plants": plants, "methods": methods, "panel": panel,
            "gateways": gateways,
        }  # fmt: skip
        for name in sys.argv[1:] or tables:
            lines = tables[name]()
            (HERE / f"{name}.md").write_text("\n".join(lines) + "\n", "utf-8")
            print("\n".join(lines), flush=True)


if __name__ == "__main__":
    main()
