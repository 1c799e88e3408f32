"""Experiments on the virtual axes: numbers against the truth, and refusals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from commissioning.experiments.relay import Relay
from commissioning.interruption import Interruption
from commissioning.journal import Journal
from commissioning.session.desk import Desk, Options
from commissioning.session.identify import Failure, identify
from drivers.home import home
from drivers.link import axis_of, parse
from drivers.sample import Sample, Status
from drivers.virtual.axes import AXES, configured
from profiles.axis import Mechanics

Identify = Callable[..., dict[str, Any]]


@pytest.fixture
def run() -> Identify:
    def measure(link: str, **options: Any) -> dict[str, Any]:
        with Journal(home()) as journal, Interruption() as interruption:
            desk = Desk(journal, interruption, lambda text: None, lambda q, w: True)
            return identify(axis_of(link), Options(**options), desk)

    return measure


@pytest.mark.parametrize("name", AXES)
def test_friction_is_within_6_percent_on_every_axis_at_1_ms(run: Identify, name: str) -> None:
    friction = run(f"virtual://{name}", cycle=0.001)["friction"]
    truth = AXES[name]
    assert friction["coulomb"]["value"] == pytest.approx(truth.coulomb, rel=0.06)
    assert friction["coulomb"]["low"] <= truth.coulomb <= friction["coulomb"]["high"]
    assert friction["offset"]["value"] == pytest.approx(truth.load, abs=0.03 * truth.coulomb)
    assert friction["coulomb"]["raw"] == pytest.approx(
        1000 * friction["coulomb"]["value"] / truth.rated, rel=1e-9
    )


@pytest.mark.parametrize(
    "options",
    ["breakaway=0.13", "load=0.05", "lag=0.001&asymmetry=0.2", "encoder=2500", "delay=0.01",
     "viscous=0.02", "coulomb=0.4", "coulomb=0.02"],
)  # fmt: skip
@pytest.mark.parametrize("cycle", [0.001, 0.005])
def test_friction_is_within_8_percent_whatever_the_axis(
    run: Identify, options: str, cycle: float
) -> None:
    link = parse(f"virtual://bench?{options}")
    found = run(link.text, cycle=cycle)["friction"]["coulomb"]["value"]
    assert found == pytest.approx(configured("bench", link.options).coulomb, rel=0.08)


@pytest.mark.parametrize("name", ["bench", "vertical", "emps"])
@pytest.mark.parametrize("cycle", [0.001, 0.004])
def test_modulating_functions_find_everything_in_a_short_record(
    run: Identify, name: str, cycle: float
) -> None:
    result = run(f"virtual://{name}", cycle=cycle, method="modulating")
    friction, truth = result["friction"], AXES[name]
    assert friction["method"] == "modulating"
    assert friction["coulomb"]["value"] == pytest.approx(truth.coulomb, rel=0.01)
    assert friction["inertia"]["value"] == pytest.approx(truth.inertia, rel=0.01)
    assert friction["dead_time"]["value"] == pytest.approx(truth.delay, rel=0.1)
    assert friction["offset"]["value"] == pytest.approx(truth.load, abs=0.01 * truth.coulomb)
    assert result["methods"]["modulating"]["periods"] < 15
    assert "two-relay" not in result["methods"]


def test_modulating_functions_make_the_critical_point_exact(run: Identify) -> None:
    point = run("virtual://bench", method="modulating")["critical_point"]["corrected"]
    w = 2 * 3.141592653589793 / point["period"]
    truth = 1 / abs(1e-3 * (1j * w) ** 2 + 2e-3 * 1j * w)
    assert point["gain"] == pytest.approx(truth, rel=0.01)
    lag = 360 / point["period"] * 0.002
    assert point["phase_deg"] == pytest.approx(-180 + 1.8 - lag, abs=2)


def test_all_reads_the_tests_of_the_thesis_by_both_methods(run: Identify) -> None:
    result = run("virtual://bench", method="all")
    assert set(result["methods"]) == {"two-relay", "modulating"}
    assert result["friction"]["method"] == "modulating"
    assert result["friction"]["coulomb"]["value"] == pytest.approx(0.1, rel=0.01)
    assert result["methods"]["two-relay"]["coulomb"] == pytest.approx(0.1, rel=0.06)
    written = {item["parameter"] for item in result["compensation"]}
    assert "viscous_gain" in written, "viscous friction is seen, so it is compensated"


def test_an_asymmetric_friction_shows_as_an_offset(run: Identify) -> None:
    offset = run("virtual://bench?asymmetry=0.2")["friction"]["offset"]["value"]
    assert offset == pytest.approx(0.02, abs=0.004)


def test_the_rule_of_the_thesis_can_be_chosen(run: Identify) -> None:
    result = run("virtual://bench", solver="thesis")
    assert result["friction"]["coulomb"]["value"] == pytest.approx(0.1, rel=0.06)
    assert result["experiment"]["tests"] > 4, "it converges more slowly than the bracket"


def test_the_naive_point_is_far_off_and_the_corrected_one_is_not(run: Identify) -> None:
    result = run("virtual://bench")
    points, period = result["critical_point"], result["critical_point"]["corrected"]["period"]
    w = 2 * 3.141592653589793 / period
    truth = 1 / abs(1e-3 * (1j * w) ** 2 + 2e-3 * 1j * w)
    assert points["corrected"]["gain"] == pytest.approx(truth, rel=0.08)
    assert points["naive"]["gain"] < 0.75 * truth


@pytest.mark.parametrize(
    ("link", "options", "code", "words"),
    [
        ("virtual://bench?coulomb=1.5", {}, 6, "no motion up to 1 N.m"),
        ("virtual://bench?coulomb=0.7", {}, 6, "raise --max-torque"),
        ("virtual://bench", {"travel": 1e-3}, 3, "too small"),
        ("virtual://bench", {"max_torque": 9.0}, 3, "above the drive's own limit"),
        ("virtual://bench?load=0.15", {}, 3, "moves by itself"),
        ("virtual://bench", {"duration": 2.0}, 5, "duration"),
        ("virtual://bench", {"max_speed": 0.5}, 5, "speed"),
    ],
)
def test_what_cannot_be_measured_is_refused_with_the_reason(
    run: Identify, link: str, options: dict[str, float], code: int, words: str
) -> None:
    with pytest.raises(Failure) as caught:
        run(link, **options)
    assert caught.value.error.exit_code == code, str(caught.value)
    assert words in str(caught.value)
    result = caught.value.result
    assert result["status"] != "completed"
    assert result["friction"]["coulomb"]["value"] is None, "not measured is null, never 0"


def test_a_load_that_nobody_declared_is_noticed_before_it_falls_far() -> None:
    axis = axis_of("virtual://vertical")
    held_by_friction = axis.model_copy(update={"mechanics": Mechanics()})
    with Journal(home()) as journal, Interruption() as interruption:
        desk = Desk(journal, interruption, lambda text: None, lambda q, w: True)
        with pytest.raises(Failure, match="does not stay at rest") as caught:
            identify(held_by_friction, Options(), desk)
    assert caught.value.error.exit_code == 3
    assert caught.value.result["experiment"]["travel"] < 0.01


def test_a_refused_confirmation_moves_nothing(run: Identify) -> None:
    with Journal(home()) as journal, Interruption() as interruption:
        desk = Desk(journal, interruption, lambda text: None, lambda q, w: False)
        with pytest.raises(Failure) as caught:
            identify(axis_of("virtual://bench"), Options(), desk)
    assert caught.value.error.exit_code == 3
    assert caught.value.result["run"] is None


OK = Status(enabled=True, fault=False, stopping=False, limit=False, word=0x27)


def at(time: float, position: float) -> Sample:
    return Sample(time, position, 0.0, 0.0, time, OK, 0.0, 0)


def test_a_sampled_relay_switches_on_samples() -> None:
    relay = Relay(1.0, 0.1, 0.0, 0.01, fractional=False)
    positions = [0.0, 0.08, 0.12, 0.05, -0.08, -0.12, 0.0]
    torques = [relay.switch(at(0.01 * n, y)) for n, y in enumerate(positions)]
    assert torques == [1, 1, -1, -1, -1, 1, 1]


def test_the_fractional_sample_has_the_area_of_both_torques() -> None:
    relay = Relay(1.0, 0.1, 0.0, 0.01, bias=0.2)
    relay.switch(at(0.00, 0.04))
    # 0.02 a cycle: the crossing at 0.1 comes three quarters into the cycle after 0.085
    relay.switch(at(0.01, 0.065))
    assert relay.switch(at(0.02, 0.085)) == pytest.approx(0.2 + 0.75 - 0.25)
    assert relay.switch(at(0.03, 0.105)) == pytest.approx(0.2 - 1.0)
