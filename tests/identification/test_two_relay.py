"""The thesis' formulas: as algebra, and on limit cycles with a known friction."""

from __future__ import annotations

from math import pi, sin

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from commissioning.identification.describing_function import equivalent
from commissioning.identification.limit_cycle import LimitCycle, measure, periods_of
from commissioning.identification.two_relay import (
    from_cycles,
    solve,
)

from .axis import matched


@given(
    f_re=st.floats(0.01, 1), f_im=st.floats(-0.5, 0.5), d1=st.floats(0.2, 3),
    share=st.floats(0.05, 0.9), a1=st.floats(0.01, 3), growth=st.floats(1.2, 4),
)  # fmt: skip
def test_equal_nonlinearities_give_back_the_friction_that_was_put_in(
    f_re: float, f_im: float, d1: float, share: float, a1: float, growth: float
) -> None:
    f = complex(f_re, f_im)
    n = complex(equivalent(a1, d1, share * a1, f))
    a2 = growth * a1
    outer = n * pi * a2 / 4 - 1j * f  # d2·e^(−jα2) of the test that sees the same N
    d2, alpha = abs(outer), -np.angle(outer)
    assume(0 <= alpha < pi / 2 and d2 > 1e-3)
    found = solve(d1, share * a1, a1, d2, a2 * sin(alpha), a2)
    assert found == pytest.approx(f, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("f", [0.05, 0.08, 0.1])
@pytest.mark.parametrize("ratio", [1.5, 2.0, 3.0])
def test_on_a_rigid_axis_the_first_harmonic_is_good_to_a_few_percent(
    f: float, ratio: float
) -> None:
    first, second = matched(j=1e-3, f=f, d1=0.17, eps1=0.02, d2=0.17 * ratio)
    assert first.period == pytest.approx(second.period)
    found = solve(first.d, first.eps, first.half_swing, second.d, second.eps, second.half_swing)
    assert abs(found) == pytest.approx(f, rel=0.06)


def cycles(f: float = 0.1, cycle: float = 0.001) -> tuple[LimitCycle, LimitCycle]:
    found = []
    for axis in matched(j=1e-3, f=f, d1=0.17, eps1=0.02, d2=0.3):
        periods = periods_of(*axis.sample(cycle, 10.0), reference=0.0)
        found.append(measure(periods, axis.d, axis.eps, 0.0, is_settled=True))
    return found[0], found[1]


def test_the_interval_holds_the_truth_and_names_an_offset_of_zero() -> None:
    estimate = from_cycles(*cycles())
    assert estimate.coulomb.low < 0.1 < estimate.coulomb.high
    assert estimate.offset.low < 0.0 < estimate.offset.high
    assert estimate.coulomb.high - estimate.coulomb.low < 0.02
    assert abs(estimate.complex_coulomb) == pytest.approx(estimate.coulomb.value)


def test_equal_half_swings_and_impossible_hystereses_are_refused() -> None:
    with pytest.raises(ValueError, match="same half-swing"):
        solve(1, 0.1, 0.5, 2, 0.1, 0.5)
    with pytest.raises(ValueError, match="never switches"):
        solve(1, 0.6, 0.5, 2, 0.1, 0.7)
