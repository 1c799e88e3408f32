"""Mean, spread and drift of repeats against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from commissioning.identification.estimate import Estimate
from commissioning.identification.repeats import Repeats


def repeats(values: list[float], half: float = 1e-4, every: float = 2.0) -> Repeats:
    estimates = [Estimate(v, v - half, v + half) for v in values]
    return Repeats.of(estimates, [every * n for n in range(len(values))])


def test_repeats_that_scatter_have_their_standard_deviation_and_no_drift() -> None:
    values = [0.101, 0.099, 0.1005, 0.0995, 0.1002]
    found = repeats(values)
    assert found.spread == pytest.approx(np.std(values, ddof=1))
    assert found.mean.value == pytest.approx(np.mean(values))
    assert found.drift is not None
    line = stats.linregress(found.times, values)
    assert found.drift.value == pytest.approx(line.slope)
    half = stats.t.ppf(0.975, 3) * line.stderr
    assert found.drift.high - found.drift.value == pytest.approx(half)
    assert found.drift.low < 0 < found.drift.high


def test_a_drift_is_told_apart_from_the_spread_about_it() -> None:
    noise = [1e-5, -1e-5, -1e-5, 1e-5]
    found = repeats([0.1 + 0.002 * n + e for n, e in enumerate(noise)])
    assert found.drift is not None
    assert found.drift.value == pytest.approx(0.001, rel=0.02)
    assert found.drift.low > 0
    assert found.spread < 3e-5
    assert found.mean.low < 0.1
    assert found.mean.high > 0.106


def test_two_repeats_have_a_spread_and_one_has_nothing() -> None:
    assert repeats([0.1, 0.102]).drift is None
    assert repeats([0.1, 0.102]).spread == pytest.approx(0.002 / 2**0.5)
    alone = repeats([0.1])
    assert (alone.spread, alone.drift) == (0.0, None)
    assert alone.mean == Estimate(0.1, 0.1 - 1e-4, 0.1 + 1e-4)
