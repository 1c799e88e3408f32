"""Random axes and settings: position, speed and torque stay within their limits, and no energy is left."""

from __future__ import annotations

from pathlib import Path

from tests.faults.limits import one


def test_thirty_axes(tmp_path: Path) -> None:
    """`make limits` draws 10 000."""
    outcomes = [one(seed, tmp_path / str(seed)) for seed in range(30)]
    assert [o for o in outcomes if not o.held] == []
    assert sum(o.code == 0 for o in outcomes) > 1
