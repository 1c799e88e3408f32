"""The control chart against closed forms, and what ends or explains a change."""

from __future__ import annotations

from dataclasses import replace
from math import exp, pi, sqrt

import numpy as np
import pytest
from numpy.typing import NDArray

from commissioning.history.drift import BASELINE, LIMIT, TRIAL, Chart, drift
from commissioning.history.telling import drift_words
from commissioning.result.experiment import Conditions
from commissioning.result.found import Quantity
from commissioning.result.history import IndexedRun, Note
from tests.history.made import DAY, MARCH_3, run, runs

_WEIGHT = 0.2


def run_length(shift: float) -> float:
    """Mean number of runs to an alarm, by the integral equation of Crowder (1987).

    L(u) = 1 + ∫ L(y)·φ((y − (1−λ)u)/λ − shift)/λ dy over |y| ≤ limit, by Gauss and Legendre.
    """
    nodes, weights = np.polynomial.legendre.leggauss(60)
    y, w = nodes * LIMIT, weights * LIMIT

    def kernel(u: float) -> NDArray[np.float64]:
        z = (y - (1 - _WEIGHT) * u) / _WEIGHT - shift
        found: NDArray[np.float64] = w * np.exp(-(z**2) / 2) / sqrt(2 * pi) / _WEIGHT
        return found

    lengths = np.linalg.solve(np.eye(60) - np.array([kernel(u) for u in y]), np.ones(60))
    return float(1 + kernel(0.0) @ lengths)


def simulated(shift: float, count: int, seed: int) -> tuple[float, float]:
    """Mean number of runs to an alarm of the product's chart, and its standard error."""
    random = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        chart = Chart(centre=1.0, between=0.01, gate=0.0)
        number = 1
        while not chart.add(1 + 0.01 * (random.standard_normal() + shift), 0.0):
            number += 1
        found.append(number)
    return float(np.mean(found)), float(np.std(found) / sqrt(count))


def test_the_run_lengths_are_those_of_the_design() -> None:
    assert run_length(0) == pytest.approx(380, abs=15)
    assert run_length(1) == pytest.approx(9.8, abs=0.5)


@pytest.mark.parametrize("shift", [0.5, 1.0, 2.0])
def test_the_chart_alarms_as_soon_as_the_integral_equation_says(shift: float) -> None:
    mean, error = simulated(shift, 2000, 1)
    assert mean == pytest.approx(run_length(shift), abs=4 * error)


def test_a_false_alarm_is_as_rare_as_the_integral_equation_says() -> None:
    mean, error = simulated(0, 400, 2)
    assert mean == pytest.approx(run_length(0), abs=4 * error)


def test_the_baseline_is_mean_and_scatter_beside_the_runs_own() -> None:
    random = np.random.default_rng(3)
    values = 0.1 + 0.001 * random.standard_normal(BASELINE)
    chart = Chart()
    for value in values:
        assert chart.add(value, 0.0005) is None
    assert chart.centre == pytest.approx(values.mean(), rel=1e-12)
    assert chart.between == pytest.approx(sqrt(values.var(ddof=1) - 0.0005**2), rel=1e-9)
    level = float(values.mean())
    for _ in range(TRIAL):
        assert not chart.add(level, 0.0005)
        assert chart.baseline == BASELINE, "a change that is not seen yet is not learnt"
    chart.add(level, 0.0005)
    assert chart.baseline == BASELINE + 1, "it grows by runs in control"
    for _ in range(3 * TRIAL):
        chart.add(0.12, 0.0005)
    assert chart.baseline <= BASELINE + 4, "and not by others"


def test_a_change_is_not_learnt_before_it_is_seen() -> None:
    """One standard deviation, after a baseline of twenty: four times as soon as if it were."""
    random = np.random.default_rng(8)
    lengths = []
    for _ in range(300):
        chart = Chart(gate=0.0)
        for value in 1 + 0.01 * random.standard_normal(BASELINE):
            chart.add(float(value), 0.0)
        number = 1
        while not chart.add(1 + 0.01 * (random.standard_normal() + 1), 0.0) and number < 5000:
            number += 1
        lengths.append(number)
    assert float(np.mean(lengths)) < 45


# -- what is said ---------------------------------------------------------------------------------


def noisy(count: int, level: float = 0.1, seed: int = 4) -> list[float]:
    random = np.random.default_rng(seed)
    return list(level * (1 + 0.01 * random.standard_normal(count)))


def changed(before: int = 30, after: int = 12, by: float = 1.18) -> list[IndexedRun]:
    return runs(noisy(before) + noisy(after, 0.1 * by, 5))


def test_friction_that_has_risen_is_said_in_the_words_of_maintenance() -> None:
    entries = changed()
    note = Note("x", MARCH_3, "regreased", number=0)
    found = drift(entries, [note], "coulomb")
    assert found is not None
    assert found.state == "drifting"
    assert found.change == pytest.approx(18, abs=found.change_error)
    assert found.change_error is not None
    assert found.change_error < 2
    seen = [p.run for p in found.points].index(found.first_run)
    assert 30 <= seen < 36, "18 times the scatter is seen at once"
    words = drift_words("press-7-x", found)
    assert words.startswith("friction of press-7-x: +18 % ± ")
    assert "since the note 'regreased' of 3 March 2026, seen first on " in words


def test_a_smaller_change_than_the_gate_is_no_alarm() -> None:
    entries = changed(by=1.07)
    small = drift(entries, [], "coulomb")
    assert small is not None
    assert small.state == "in control"
    assert small.change_error is not None
    assert small.change == pytest.approx(7, abs=2 * small.change_error)
    assert drift(entries, [], "coulomb", gate=5).state == "drifting"


def test_what_comes_back_is_no_alarm_any_more() -> None:
    entries = runs(noisy(30) + noisy(10, 0.13, 5) + noisy(20, 0.1, 6))
    found = drift(entries, [], "coulomb")
    assert found is not None
    assert found.state == "in control"
    assert found.first_seen is None


def warmth(one: IndexedRun) -> float:
    found = one.conditions.motor_temperature
    assert found is not None
    return found


def worse(one: IndexedRun, by: float) -> dict[str, Quantity]:
    before = one.quantities["coulomb"]
    return {"coulomb": Quantity(by * before.value, None, None, "N.m")}


@pytest.mark.parametrize("slope", [0.0, 0.012, 0.03])
def test_temperature_explains_it(slope: float) -> None:
    """Friction falls by one or three percent a kelvin; the hall has a winter and a summer."""
    random = np.random.default_rng(7)
    entries = []
    for number in range(1, 161):
        warm = 40 + 14 * np.sin(2 * pi * number / 52)
        value = 0.1 * exp(-slope * (warm - 40)) * (1 + 0.01 * random.standard_normal())
        seen = Conditions(motor_temperature=float(warm), third=1)
        entries.append(run(number, float(value), conditions=seen))
    for last in range(21, 161):
        found = drift(entries[:last], [], "coulomb")
        assert found is not None
        assert found.state != "drifting", f"run {last}: {found.change} %"
    worn = [replace(one, quantities=worse(one, 1.3)) for one in entries[130:]]
    found = drift([*entries[:130], *worn], [], "coulomb")
    assert found is not None
    assert found.state == "drifting", "and does not hide wear"
    cold = [one for one in entries if abs(warmth(one) - 54) <= 10]
    hot = replace(entries[-1], number=999, conditions=Conditions(motor_temperature=54.0, third=1))
    found = drift([*entries, hot], [], "coulomb")
    assert found is not None
    assert {p.run for p in found.points} == {one.run for one in cold} | {hot.run}
    assert found.left_out == len(entries) - len(cold)


@pytest.mark.parametrize(
    ("conditions", "left_out"),
    [
        (Conditions(motor_temperature=51.0, third=1), 30),
        (Conditions(motor_temperature=49.0, third=1), 0),
        (Conditions(third=1), 30),
        (Conditions(motor_temperature=40.0, third=2), 30),
        (Conditions(motor_temperature=40.0), 30),
    ],
)
def test_only_like_runs_are_compared(conditions: Conditions, left_out: int) -> None:
    entries = [*runs(noisy(30)), run(31, 0.2, conditions=conditions)]
    found = drift(entries, [], "coulomb")
    assert found is not None
    assert found.left_out == left_out
    assert found.state != "drifting" or not left_out


def test_what_is_not_known_is_said() -> None:
    found = drift(runs(noisy(30), conditions=Conditions()), [], "coulomb")
    assert found is not None
    assert found.left_out == 0, "unknown in both is alike"
    assert "temperature" in found.said[0]
    assert "ends" in found.said[1]


@pytest.mark.parametrize(
    ("later", "words"),
    [
        ({"serial": "0x2"}, "the drive was exchanged for 0x2"),
        ({"method": "lock-in"}, "the method became 'lock-in'"),
        ({"version": "2.0.0"}, "tworelay became 2.0.0"),
    ],
)
def test_an_event_ends_the_baseline(later: dict[str, object], words: str) -> None:
    entries = [*runs(noisy(30)), run(31, 0.2, **later), run(32, 0.2, **later)]
    found = drift(entries, [], "coulomb")
    assert found is not None
    assert found.state == "not enough runs"
    assert found.since_text == words
    assert [p.run for p in found.points] == ["r31", "r32"]


def test_a_minor_version_ends_nothing() -> None:
    entries = [*runs(noisy(30)), run(31, 0.1, version="1.9.0")]
    assert len(drift(entries, [], "coulomb").points) == 31
    old = [replace(one, version="0.1.0") for one in entries[:-1]]
    assert drift([*old, replace(entries[-1], version="0.2.0")], [], "coulomb").baseline == 0


@pytest.mark.parametrize("by_date", [True, False])
def test_a_note_ends_the_baseline(by_date: bool) -> None:
    entries = changed()
    last = entries[29]
    note = Note("x", last.began + DAY, "new belt", number=last.number, dated=by_date)
    found = drift(entries, [note], "coulomb")
    assert found is not None
    assert found.state == "not enough runs"
    assert len(found.points) == 12
    assert found.since_text == "the note 'new belt'"


def test_a_note_behind_the_last_run_leaves_nothing_to_compare() -> None:
    entries = changed()
    note = Note("x", entries[-1].began + DAY, "new belt", dated=True)
    found = drift(entries, [note], "coulomb")
    assert found is not None
    assert found.points == ()
    assert drift_words("x", found).startswith("friction of x: no run since the note 'new belt'")


def at(temperature: float | None) -> Conditions:
    return Conditions(motor_temperature=temperature, third=1)


@pytest.mark.parametrize("last", [18.0, None, 60.0])
def test_an_alarm_stays_when_the_next_run_is_made_under_other_conditions(
    last: float | None,
) -> None:
    healthy = [run(n, v, conditions=at(30.0)) for n, v in enumerate(noisy(25), 1)]
    worn = [
        run(n, v, conditions=at(26.0)) for n, v in enumerate(noisy(26, 0.15, 5), len(healthy) + 1)
    ]
    seen = drift([*healthy, *worn], [], "coulomb")
    assert seen is not None
    assert seen.alarm
    later = drift([*healthy, *worn, run(99, 0.15, conditions=at(last))], [], "coulomb")
    assert later is not None
    assert later.alarm
    assert later.change == pytest.approx(seen.change, rel=0.05)
    if last != 18.0:  # which is like those at 26 °C
        assert (later.newer, later.left_out) == (1, 1)
        assert "(1 of them newer, the last that is compared of " in drift_words("x", later)


@pytest.mark.parametrize("first", [20.0, 60.0])
def test_an_alarm_of_one_kind_of_days_stays_until_such_a_day_ends_it(first: float) -> None:
    """Cold and warm in turn; then warm ones with half as much more, and cold ones as ever."""
    other = {20.0: 60.0, 60.0: 20.0}[first]
    healthy = noisy(60)
    entries = [
        run(n, v, conditions=at(first if n % 2 else other)) for n, v in enumerate(healthy, 1)
    ]
    worn = [run(61 + n, 0.15, conditions=at(60.0)) for n in range(15)]
    cold = [run(80 + n, v, conditions=at(20.0)) for n, v in enumerate(noisy(40, seed=6))]
    for ending in ([], cold[:1], cold):
        found = drift([*entries, *worn, *ending], [], "coulomb")
        assert found is not None
        assert found.alarm
        assert found.change == pytest.approx(50, abs=3)
        assert found.newer == len(ending)
    mended = [run(200 + n, v, conditions=at(60.0)) for n, v in enumerate(noisy(20, seed=7))]
    found = drift([*entries, *worn, *cold, *mended], [], "coulomb")
    assert found is not None
    assert not found.alarm


def test_a_change_that_few_runs_show_stays_as_long() -> None:
    entries = [run(1, 0.1, conditions=at(25.0))]
    entries += [run(2 + n, 0.15, conditions=at(25.0)) for n in range(14)]
    found = drift([*entries, run(20, 0.1, conditions=at(40.0))], [], "coulomb")
    assert found is not None
    assert (found.state, found.alarm) == ("changed", True)
    many = [run(20 + n, 0.1, conditions=at(40.0)) for n in range(30)]
    found = drift([*entries, *many], [], "coulomb")
    assert found is not None
    assert not found.alarm, "and not for ever"


def test_a_baseline_of_noise_does_not_tell_what_the_temperature_does() -> None:
    """Baselines of 5 % scatter over 2 K, then a third more friction at 9 K less."""
    missed = 0
    for seed in range(20):
        random = np.random.default_rng(seed)
        warm = 40 + 2.2 * random.standard_normal(40)
        values = 0.1 * (1 + 0.05 * random.standard_normal(40))
        entries = [
            run(n, float(v), conditions=at(float(w)))
            for n, (v, w) in enumerate(zip(values, warm, strict=True), 1)
        ]
        entries += [run(50 + n, 0.13, conditions=at(33.0)) for n in range(12)]
        found = drift(entries, [], "coulomb")
        assert found is not None
        missed += not found.alarm
    assert missed <= 2


@pytest.mark.parametrize(
    ("values", "state"),
    [([0.1, 0.1001], "not enough runs"), ([0.1, 0.12], "changed"), ([0.1], "not enough runs")],
)
def test_few_runs_are_compared_by_their_intervals(values: list[float], state: str) -> None:
    found = drift(runs(values), [], "coulomb")
    assert found is not None
    assert found.state == state
    if state == "changed":
        assert found.change == pytest.approx(20)
        assert "outside both intervals" in drift_words("x", found)


@pytest.mark.parametrize("odd", ["unmeasured", "unknown ends", "zero", "equal", "negative"])
def test_odd_histories(odd: str) -> None:
    entries = runs(noisy(30))
    if odd == "unmeasured":
        found = drift([*entries, run(31, 9.0, verdict="rejected")], [], "coulomb")
        assert len(found.points) == 30
    elif odd == "unknown ends":
        bare = replace(entries[0].quantities["coulomb"], low=None, high=None)
        assert drift([replace(e, quantities={"coulomb": bare}) for e in entries], [], "coulomb")
    elif odd == "zero":
        assert drift(runs([0.0] * 30), [], "coulomb") is None
    elif odd == "equal":
        found = drift(runs([0.1] * 30, half=0.0), [], "coulomb")
        assert found.state == "in control"
        assert drift(runs([0.1] * 30 + [0.12] * 5, half=0.0), [], "coulomb").state == "drifting"
    else:
        found = drift(runs([-v for v in noisy(30)] + [-0.13] * 9), [], "coulomb")
        assert found.state == "drifting"
        assert found.change == pytest.approx(-30, abs=2)
    assert drift(entries, [], "inertia") is None
    assert drift([], [], "coulomb") is None
