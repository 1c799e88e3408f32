"""Output error against the virtual axes' own integration, which shares nothing with it."""

from __future__ import annotations

from dataclasses import replace
from math import atan, pi
from typing import Any

import numpy as np
import pytest

from commissioning.identification.estimate import Estimate
from commissioning.identification.modulating import ModulatingEstimate, estimate
from commissioning.identification.motion import Model
from commissioning.identification.output_error import OutputErrorEstimate, output_error
from commissioning.identification.reading import Explained
from commissioning.identification.reasons import Weight
from commissioning.identification.record import Record
from commissioning.identification.verdict import UnitNames, of_output_error
from commissioning.result.readings import MethodName
from commissioning.rig.measured import Measured
from tests.identification.spoiled import changed, relay_tests

START = Model(1.3e-3, 1e-3, 0.0, 1.5e-3)  # of the bench axis: a third off


def fitted(record: Record, **keywords: bool) -> OutputErrorEstimate:
    return output_error(record, START, 0.13, **keywords)


def holds(estimate: Estimate, truth: float) -> bool:
    return estimate.low <= truth <= estimate.high


def test_four_periods_give_every_number_of_a_rigid_axis() -> None:
    record = relay_tests({"lag": "0.0007", "load": "0.02", "asymmetry": "0.1"}, periods=2)
    found = fitted(record)
    assert found.is_explained
    assert found.terms == ()
    assert found.coulomb.value == pytest.approx(0.1, rel=2e-3)
    assert found.coulomb.half_width < 0.01
    assert found.lag.value == pytest.approx(0.7e-3, rel=0.05)
    w = 2 * pi / found.period
    truth = {
        "coulomb": 0.1, "offset": 0.02 + 0.1 * 0.1, "viscous": 2e-3, "inertia": 1e-3,
        "dead_time": 2e-3 + atan(w * 0.7e-3) / w, "lag": 0.7e-3,
    }  # fmt: skip
    assert all(holds(getattr(found, name), value) for name, value in truth.items())


@pytest.mark.parametrize(
    ("options", "term", "size"),
    [
        ({"drag": "1e-4"}, "drag", 1e-4),
        ({"load_friction": "0.1"}, "load", 0.1),
        ({"spring": "0.3"}, "spring", 0.3),
        ({"eccentricity": "0.01"}, "eccentricity", 0.01),
    ],
)
def test_a_term_that_the_record_shows_is_found(
    options: dict[str, str], term: str, size: float
) -> None:
    # an eccentric encoder shows a gain in a short swing, its curvature in a long one only
    record = relay_tests(options, hysteresis=0.5 if term == "eccentricity" else 0.03)
    found = fitted(record)
    assert found.terms == (term,)
    assert found.is_explained
    assert found.values[0].value == pytest.approx(size, rel=0.03)
    assert found.coulomb.value == pytest.approx(0.1, rel=2e-3)
    assert holds(found.coulomb, 0.1)


def test_friction_that_drifts_is_told_as_its_mean() -> None:
    record = relay_tests({"drift": "0.02"}, periods=8)
    found = fitted(record)
    assert found.terms == ("drift",)
    assert found.values[0].value == pytest.approx(0.02, rel=0.05)
    assert found.coulomb.value == pytest.approx(0.1 * (1 + 0.02 * record.time.mean()), rel=2e-3)


@pytest.mark.parametrize(
    "options",
    [
        {"stribeck": "1.0", "breakaway": "0.15"},
        {"dahl": "0.01"},
        {"resonance": "25", "ratio": "1"},
        {"cogging": "0.02", "pitch": "0.02"},
    ],
)
def test_friction_of_another_kind_is_not_explained(options: dict[str, str]) -> None:
    try:
        found = fitted(relay_tests(options))
    except ValueError:
        return
    assert not found.is_explained or found.coulomb.half_width > 0.03


def test_noise_makes_the_interval_as_wide_as_the_numbers_scatter() -> None:
    record, rng = relay_tests(), np.random.default_rng(5)
    found = []
    for _ in range(12):
        noise = rng.normal(0, 8 * record.resolution, len(record.position))
        noisy = changed(record, position=record.position + noise)
        found.append(output_error(noisy, START, 0.13, noise=8 * record.resolution))
    assert all(one.is_explained for one in found)
    assert sum(holds(one.coulomb, 0.1) for one in found) >= 11
    scatter = float(np.std([one.coulomb.value for one in found], ddof=1))
    told = float(np.median([one.coulomb.half_width for one in found])) * 0.1
    assert scatter < told < 8 * scatter + 1e-4


def test_stretches_with_a_rest_between_are_one_measurement() -> None:
    """Gaps, a shift of the zero, and what the axis did meanwhile are nothing to it."""
    first, second = relay_tests(periods=2), relay_tests(periods=3)
    apart = 2.0
    later = first.time[-1] + apart
    both = Record.of(
        np.concatenate((first.time, second.time + later)),
        np.concatenate((first.position, second.position + 0.7)),
        np.concatenate((first.sent, second.sent + later)),
        np.concatenate((first.command, second.command)),
        first.resolution,
    )
    spans = [(0.0, float(first.time[-1])), (later, float(later + second.time[-1]))]
    found = output_error(both, START, 0.13, spans=spans)
    alone = fitted(first)
    assert found.is_explained
    assert holds(found.coulomb, 0.1)
    assert found.coulomb.half_width < alone.coulomb.half_width
    assert found.periods == pytest.approx(10, abs=2)


def test_it_ends_in_the_same_place_from_anywhere_near() -> None:
    record = relay_tests()
    near = output_error(record, Model(1e-3, 2e-3, 0.0, 2e-3), 0.1)
    assert fitted(record).coulomb.value == pytest.approx(near.coulomb.value, rel=1e-6)


def test_what_fewer_periods_would_have_given_narrows_down_to_the_number() -> None:
    found = fitted(relay_tests())
    widths = [one.coulomb.high - one.coulomb.low for one in found.progress]
    periods = [one.periods for one in found.progress]
    assert periods[0] == pytest.approx(2, abs=0.3)
    assert periods[-1] == pytest.approx(found.periods, abs=0.2)
    assert len(widths) >= 6
    assert widths == sorted(widths, reverse=True)
    assert all(holds(one.coulomb, 0.1) for one in found.progress)
    assert found.progress[-1].coulomb.value == pytest.approx(found.coulomb.value, rel=1e-3)


def test_a_record_of_nothing_is_said() -> None:
    record = relay_tests()
    still = changed(record, position=np.zeros(len(record.time)))
    with pytest.raises(ValueError, match="0 velocity reversals; 4 are needed"):
        fitted(still)


def test_a_torque_that_only_lags_is_no_edge() -> None:
    found = fitted(relay_tests({"lag": "0.004", "delay": "0"}))
    assert found.is_explained
    assert found.terms == ()
    assert holds(found.coulomb, 0.1)
    assert holds(found.viscous, 2e-3)
    assert found.lag.value == pytest.approx(4e-3, rel=0.02)


def test_a_law_that_drifts_is_another_one_at_another_time() -> None:
    """0.1·(1 + 0.02·t): read at 30 s where it was found in the first seconds."""
    record = relay_tests({"drift": "0.02"}, periods=8)
    found = Explained.of(fitted(record))
    assert found is not None
    later = changed(record, time=record.time + 30, sent=record.sent + 30)
    middle = 0.5 * float(later.time[0] + later.time[-1])
    assert found.during(later)[0] == pytest.approx(0.1 * (1 + 0.02 * middle), rel=0.02)


def test_an_unexplained_fit_gives_no_number_where_another_method_has_one() -> None:
    record = relay_tests()
    good = fitted(record)
    bad, other = replace(good, is_explained=False), estimate(record)
    nothing: Any = None

    def method(**found: OutputErrorEstimate | ModulatingEstimate) -> str:
        by = {MethodName[name.upper()]: one for name, one in found.items()}
        return Measured(nothing, nothing, nothing, record, 4, by=dict(by)).method.value

    assert method(output_error=bad, modulating=other) == "modulating"
    assert method(output_error=good, modulating=other) == "output-error"
    assert method(output_error=bad) == "output-error"


@pytest.mark.parametrize(("spring", "weight"), [("0.4", Weight.DOUBT), ("0.05", Weight.NOTE)])
def test_a_spring_may_be_the_way_to_a_load_at_rest(spring: str, weight: Weight) -> None:
    found = fitted(relay_tests({"spring": spring}))
    reasons = {one.code: one for one in of_output_error(found, 1.0, UnitNames())}
    assert set(reasons) == {"law.spring"}
    assert reasons["law.spring"].weight is weight
    assert found.only_winds_up(0.1) is False
    assert replace(found, values=(Estimate(4.0, 4.0, 4.0),)).only_winds_up(0.2) is True
