"""A drive is served by what was measured, and measures the same again."""

from __future__ import annotations

import json
from dataclasses import replace
from math import pi
from pathlib import Path

import pytest

from commissioning.journal import Journal
from commissioning.result.document import Quality, RunResult
from commissioning.result.experiment import Conditions
from commissioning.result.found import DriveTrain, Found, Quantity
from commissioning.result.readings import LawReading, Methods, ModulatingReading
from commissioning.runs import RunFolder, resolve
from commissioning.session.twin import MeasuredTwin, numbered, twin_of_run
from drivers.home import home
from profiles.axis import Axis, AxisLimits, Mechanics, load_axis
from profiles.errors import Refused, UsageError
from tests.conftest import Serve, Tworelay
from tests.result.test_codec import recorded
from tests.twins.campaign import KINDS, cases, deviations, measured_twice

_TRIED = "gravity", "viscous", "geared", "linear"


@pytest.mark.parametrize("kind", _TRIED)
def test_a_twin_measures_what_its_run_did(kind: str, tmp_path: Path) -> None:
    number = list(KINDS).index(kind)
    case = list(cases(len(KINDS)))[number]
    pair = measured_twice(case, tmp_path)
    found = list(deviations(*pair))
    assert len(found) >= 7
    assert [(name, share) for name, share, holds in found if not holds] == []


# -- of which parts it is made --------------------------------------------------------------------


def made(
    result: RunResult, axis: Axis | None = None, given: dict[str, str] | None = None
) -> MeasuredTwin:
    folder = RunFolder(Path("nowhere"))
    return twin_of_run(result, folder, axis or Axis(), given or {}, lambda what, unit: None)


@pytest.fixture
def good() -> RunResult:
    return recorded("good")[0]


def test_the_numbers_are_those_of_the_run(good: RunResult) -> None:
    axis = made(good).axis
    found = good.friction
    for name, option in (
        ("coulomb", axis.coulomb), ("offset", axis.load), ("viscous", axis.viscous),
        ("inertia", axis.inertia), ("dead_time", axis.delay),
    ):  # fmt: skip
        assert option == pytest.approx(found.quantity(name).value, rel=1e-9)
    assert axis.encoder == good.experiment.setup.bases.increments_per_revolution
    assert axis.rated == good.experiment.setup.bases.rated_torque
    assert axis.travel == good.experiment.limits.travel


@pytest.mark.parametrize(
    ("mechanics", "effort"),
    [
        (Mechanics(gear=10.0), 10.0),
        (Mechanics(motion="linear", feed=1.0), 2 * pi),
        (Mechanics(motion="linear", feed=0.5, gear=2), 8 * pi),
    ],
)
def test_the_motor_sees_the_axis_through_gear_and_feed(
    good: RunResult, mechanics: Mechanics, effort: float
) -> None:
    axis, found = made(good, Axis(mechanics=mechanics)).axis, good.friction
    assert axis.coulomb == pytest.approx(found.coulomb.value / effort)
    assert axis.inertia == pytest.approx(found.inertia.value / effort**2)
    assert axis.viscous == pytest.approx(found.viscous.value / effort**2)
    assert axis.speed == pytest.approx(good.experiment.limits.speed * effort)


def with_law(result: RunResult, law: LawReading) -> RunResult:
    old = result.methods.modulating
    assert isinstance(old, ModulatingReading)
    return replace(result, methods=Methods(modulating=replace(old, law=law)))


def test_the_shape_of_friction_is_that_of_the_law(good: RunResult) -> None:
    f = good.friction.coulomb.value
    terms = ("coulomb", "viscous", "stribeck", "load", "position")
    law = LawReading(terms, 2.0, None, 0.5, (f, 0.02, 0.1, 0.003, 0.004))
    axis = made(with_law(good, law), Axis(mechanics=Mechanics(gear=2.0))).axis
    assert axis.stribeck == pytest.approx(4.0)
    assert axis.breakaway == pytest.approx((f + 0.02) / 2)
    assert axis.load_friction == pytest.approx(0.1)
    assert axis.cogging == pytest.approx(0.005 / 2)
    assert axis.pitch == pytest.approx(1.0)
    soft = LawReading(("coulomb", "viscous", "soft"), None, 0.3, None, (f, 0.01))
    axis = made(with_law(good, soft)).axis
    assert axis.soft == pytest.approx(0.3)
    assert axis.soft_shift == pytest.approx(0.01 * 0.3 / f)
    assert axis.load == pytest.approx(good.friction.offset.value + 0.01)


def test_two_masses_and_the_temperature_are_those_of_the_run(good: RunResult) -> None:
    seen = DriveTrain(
        "compliant", (), quantity(6e-4), quantity(4e-4), resonance=quantity(40.0, "Hz"),
        play=quantity(0.01, "rad"),
    )  # fmt: skip
    warm = replace(good, mechanics=seen, conditions=Conditions(motor_temperature=61.0))
    axis = made(warm).axis
    assert axis.resonance == 40.0
    assert axis.ratio == pytest.approx(2 / 3)
    assert axis.backlash == pytest.approx(0.01)
    assert axis.temperature == 61.0


def quantity(value: float, unit: str = "kg.m2") -> Quantity:
    return Quantity(value, None, None, unit)


# -- what a run does not tell ---------------------------------------------------------------------


def without(result: RunResult, *names: str) -> RunResult:
    return replace(result, friction=replace(result.friction, **dict.fromkeys(names)))


def test_what_is_not_known_is_taken_from_elsewhere_and_said(good: RunResult) -> None:
    twin = made(without(good, "inertia", "viscous", "dead_time"))
    first = good.methods.modulating
    assert twin.axis.inertia == pytest.approx(first.inertia)
    assert sum("does not vouch for" in line for line in twin.said) == 3
    bare = replace(without(good, "inertia"), methods=Methods())
    twin = made(bare)
    assert twin.axis.inertia == pytest.approx(good.experiment.setup.first_look.inertia)
    assert any("first look" in line for line in twin.said)


def test_what_nothing_tells_is_asked_for(good: RunResult) -> None:
    assert good.experiment is not None
    experiment = replace(good.experiment, setup=None)
    bare = replace(without(good, "inertia"), methods=Methods(), experiment=experiment)
    with pytest.raises(UsageError, match=r"does not tell the inertia.*--set inertia=… \(kg.m2\)"):
        made(bare)
    axis = Axis(rated_torque=2.0, encoder=5000.0)
    twin = made(bare, axis, {"inertia": "0.003"})
    assert (twin.axis.inertia, twin.axis.rated, twin.axis.encoder) == (0.003, 2.0, 5000.0)
    assert any("inertia of motor and load: 0.003, as given" in line for line in twin.said)
    assert any("by the axis file" in line for line in twin.said)
    asked: list[str] = []

    def ask(what: str, unit: str) -> float:
        asked.append(what)
        return 0.004

    folder = RunFolder(Path("nowhere"))
    assert twin_of_run(bare, folder, axis, {}, ask).axis.inertia == 0.004
    assert asked == ["inertia of motor and load"]


@pytest.mark.parametrize("verdict", ["rejected", None])
def test_a_run_that_measured_nothing_has_no_twin(good: RunResult, verdict: str | None) -> None:
    nothing = replace(good, friction=Found(), quality=Quality(verdict))  # type: ignore[arg-type]
    with pytest.raises(Refused, match="measured no friction that can be trusted") as caught:
        made(nothing)
    assert caught.value.code == "twin.no-friction"


def test_a_friction_that_rises_with_the_speed_has_a_twin(good: RunResult) -> None:
    f = good.friction.coulomb.value
    law = LawReading(("coulomb", "viscous", "stribeck"), 2.0, None, None, (f, -0.03))
    axis = made(with_law(good, law)).axis
    assert axis.held_by == pytest.approx(f - 0.03)
    axis.build()


def test_a_twin_is_another_axis_and_starts_where_it_may(good: RunResult) -> None:
    ends = AxisLimits(ends=(10.0, 20.0))
    twin = made(good, Axis(name="x" * 100, limits=ends))
    assert twin.file.name == "x" * 93 + " (twin)"
    assert twin.file.limits.ends is None
    assert twin.file.cycle == good.experiment.cycle
    assert twin.file.limits.torque == good.experiment.limits.torque
    assert any("ends of its travel" in line for line in twin.said)
    assert any("profile" in line for line in twin.said)


def test_several_twins_of_one_unit_are_numbered(good: RunResult) -> None:
    twins = [made(good, Axis(link=f"modbus-tcp://a{n}?unit=3")) for n in range(3)]
    assert numbered(twins, "unit") == [3, 1, 2]
    drives = [one.served(n, n, n, None) for n, one in enumerate(twins)]
    assert len({one.axis.serial for one in drives}) == 3


# -- as a user types it ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        ((), 2, "which? Give an AXIS"),
        (("bench", "--from", "last"), 2, "serve them from two commands"),
        (("--from", "last", "--profile", "cia402"), 2, "leave --profile out"),
        (("--from", "nosuch"), 2, "no run named 'nosuch'"),
        (("--from", "last"), 3, "measured no friction that can be trusted (rejected)"),
        (("--from", "last", "--set", "inertia"), 2, "must be NAME=VALUE"),
        (("--from", "last", "--from", "last", "--axis-file", "a.toml"), 2, "do not go into one"),
        (("bench", "--modbus-tcp", "0", "--axis-file", "a.toml"), 2, "belongs to --from"),
        (("--from", "last", "--axis-file", "README.md"), 2, "is there already"),
        (("bench", "--modbus-tcp", "0", "--ready", "README.md/x"), 2, "--ready"),
    ],
)
def test_what_cannot_be_served(
    words: tuple[str, ...], code: int, says: str, tworelay: Tworelay
) -> None:
    tworelay("identify", "virtual://bench?coulomb=2.5", "--yes")
    done = tworelay("virtual", "serve", *words)
    assert done.returncode == code, done.stderr
    assert says in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_twin_has_profile_unit_and_wire_of_its_run(
    serve: Serve, tworelay: Tworelay, tmp_path: Path
) -> None:
    wire = "--modbus-tcp", "127.0.0.1:0", "--clock", "step", "--profile", "lexium-32-modbus"
    (link,) = serve("bench?unit=7", *wire)
    axis = tmp_path / "axis.toml"
    axis.write_text(
        f'link = "{link}"\nprofile = "lexium-32-modbus"\ntravel = 3\nencoder = 131072\n'
    )
    done = tworelay("identify", str(axis), "--without-watchdog", "--yes")
    assert done.returncode == 0, done.stderr
    with Journal(home(), reading=True) as journal:
        run, folder = resolve(journal, "last")
        before = folder.result()
    file = tmp_path / "twin.toml"
    (again,) = serve("--from", run, "--clock", "step", "--axis-file", str(file))
    assert "unit=7" in again
    found = load_axis(file)
    assert found.link == again
    assert found.profile == "lexium-32-modbus"
    done = tworelay("identify", str(file), "--without-watchdog", "--yes", "--json", "-")
    assert done.returncode == 0, done.stderr
    after = json.loads(done.stdout)
    assert after["profile"]["name"] == "lexium-32-modbus"
    value = after["friction"]["coulomb"]["value"]
    assert value == pytest.approx(before.friction.coulomb.value, rel=0.01)
