"""Random axes and settings.

Position, speed and torque stay within their limits, and no energy is left.
"""

from __future__ import annotations

from pathlib import Path

from tests.faults.limits import one

HARD = (3717, 5750, 9317)  # light, with little travel and a load near the friction


def test_some_axes(tmp_path: Path) -> None:
    """`make limits` draws 10 000."""
    outcomes = [one(seed, tmp_path / str(seed)) for seed in (*range(30), *HARD)]
    assert [o for o in outcomes if not o.held] == []
    assert sum(o.code == 0 for o in outcomes) > 1
