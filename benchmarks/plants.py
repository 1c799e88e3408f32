"""How fast the virtual axes are: as Python runs them, and compiled."""

from __future__ import annotations

import sys
import time
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from benchmarks.classes import CLASSES, case  # noqa: E402
from drivers.virtual import compliant_plant  # noqa: E402

_CYCLE, _HALF, _CYCLES = 1e-3, 100, 1500
_AXES = 3


def microseconds(kind: str) -> float:
    """Of a cycle of 1 ms: mean of some axes of a class, the best of two runs each."""
    total = 0.0
    for number in range(_AXES):
        axis = case(kind, 1, number).axis
        torque, best = 3 * (axis.coulomb + axis.load_coulomb), float("inf")
        for _ in range(2):
            plant = axis.build()
            begin = time.perf_counter()
            for n in range(_CYCLES):
                plant.advance(_CYCLE, torque if n // _HALF % 2 else -torque)
            best = min(best, time.perf_counter() - begin)
        total += best / _CYCLES * 1e6
    return total / _AXES


def plants() -> list[str]:
    plain = {kind: microseconds(kind) for kind in CLASSES}
    compliant_plant.accelerate()
    case("drag", 1, 0).axis.build().advance(_CYCLE, 0.0)  # compiles
    compiled = {kind: microseconds(kind) for kind in CLASSES}
    lines = [
        "# Virtual axes",
        "",
        "Written by `make bench`: µs a cycle of 1 ms under a square torque, three axes a class of the",
        "accuracy campaign; as Python runs them, and compiled (`accelerate()`, numba).",
        "",
        "| class | Python | compiled | ratio | simulated seconds a second |",
        "| --- | --- | --- | --- | --- |",
    ]
    for kind, slow in plain.items():
        fast = compiled[kind]
        lines.append(
            f"| {kind} | {slow:.1f} | {fast:.1f} | {slow / fast:.1f} | {1e6 * _CYCLE / fast:.0f} |"
        )
    return lines
