"""Everything that a profile says is done, and what is left out is noticed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import BaseModel

from commissioning.performance import acts
from commissioning.performance.acts import performed
from commissioning.performance.clauses import unheard
from commissioning.rig import preflight
from commissioning.settings import Restored, Settings
from drivers import modes, power, preparation, stopping
from drivers.access import RawAccess
from drivers.profiled import ProfiledDrive
from profiles.law import Compensation, TermValue
from profiles.library import builtin_names, check, load_profile, read_profile
from profiles.procedures import Condition
from profiles.schema import Profile
from tests.command import in_this_process

EVERYTHING = Path(__file__).with_name("everything.toml")
ON_CANOPEN = Path(__file__).with_name("everything-canopen.toml")
TWO_KEY = Path(__file__).parents[1] / "faults" / "two_key.toml"

TRIED = [*builtin_names(), str(EVERYTHING), str(ON_CANOPEN), str(TWO_KEY)]


def sections(profile: Profile) -> set[str]:
    """Where something was not performed."""
    return {clause.section for clause in unheard(performed(profile))}


@pytest.mark.parametrize("name", TRIED)
def test_all_of_a_profile_is_performed(name: str) -> None:
    assert [str(clause) for clause in unheard(performed(read_profile(name)))] == []


# -- what is left out of the drivers is noticed ---------------------------------------------------


def _nothing(*_: object, **__: object) -> None:
    return None


def _empty(*_: object, **__: object) -> dict[str, int]:
    return {}


def _without_steps(self: Any, steps: object, what: str, wait: object) -> None:
    if what == "disable":
        power.perform(self._bus, self._profile, steps, what, wait)  # type: ignore[arg-type]


def _first_only(self: Any, condition: Condition | None) -> bool:
    if condition is None:
        return False
    raw = self._bus.read(self._profile.parameters[condition.parameter].address)
    if condition.differs is not None:
        return bool(raw & condition.mask != condition.differs)
    return bool(raw & condition.mask == condition.wanted[0])


def _unsigned(self: Compensation, amount: Any) -> dict[str, TermValue]:
    found = _VALUES(self, amount)
    return {name: value._replace(value=abs(value.value)) for name, value in found.items()}


def _impatient(self: RawAccess, action: Callable[[], Any], patience: float | None = None) -> Any:
    return action()


def _told_only(self: Any, code: int) -> None:
    if self._access.bus.read(self._profile.parameters["torque_target"].address) == 0:
        self._access.bus.write(self._profile.parameters["mode_of_operation"].address, code)


def _first_code(self: Any, mode: Any) -> Any:
    return self._profile.modes[mode][0]


def _other_value(self: Any, name: str, raw: int) -> None:
    self._access.write(name, raw)


def _no_until(bus: Any, profile: Any, steps: Any, *more: Any) -> None:
    _PERFORM(bus, profile, tuple(step for step in steps if step.until is None), *more)


def _no_writes(bus: Any, profile: Any, steps: Any, *more: Any) -> None:
    _PERFORM(bus, profile, tuple(step for step in steps if step.write is None), *more)


def _settings_of_torque(self: Any, mode: Any) -> dict[str, int]:
    return self.exclusive_access()  # type: ignore[no-any-return]


def _one_way(drive: Any, kind: str) -> list[str]:
    return [name for name in (drive.limits.get(kind),) if name is not None]


def _store_uncounted(drive: Any, desk: Any, run: str, wanted: Any) -> None:
    if drive.memory is not None:
        drive.store()


def _of_another_node(self: Any) -> dict[str, int]:
    return {name: raw & 0xFFFF | 5 << 16 if name == "watchdog_time" else raw
            for name, raw in _ARMED(self).items()}  # fmt: skip


def _not_put_back(self: Settings) -> Restored:
    return Restored()


_VALUES, _PERFORM = Compensation.values, power.perform
_ARMED = preparation.Preparation.watchdog
LEFT_OUT: dict[str, tuple[object, str, object, str, str]] = {
    # what: (where, name, instead, profile, section that says so)
    "exclusive": (preparation.Preparation, "exclusive_access", _empty, "everything", "exclusive"),
    "before": (preparation.Preparation, "settings", _settings_of_torque, "dsy-rs", "modes.torque"),
    "requires": (
        preparation.Preparation, "check_requirements", _nothing, "everything", "requires",
    ),
    "stop": (stopping.StopPath, "_writes", lambda self, steps: [], "cia402", "stop"),
    "stop until": (stopping.StopPath, "_await", _nothing, "everything", "stop"),
    "stop time": (stopping.StopPath, "_await_standstill", _nothing, "cia402", "stop_time"),
    "code": (modes.Modes, "set", _nothing, "everything", "power"),
    "code, unseen": (modes.Modes, "set", _told_only, "everything", "modes.torque"),
    "supported bit": (modes.Modes, "supported", _first_code, "cia402", "modes.torque"),
    "enable": (power, "perform", _no_writes, "everything", "power"),
    "enable until": (power, "perform", _no_until, "everything", "power"),
    "store until": ("drivers.profiled", "perform", _no_until, "leadshine-el7", "store"),
    "store": ("drivers.profiled", "perform", _no_writes, "leadshine-el7", "store"),
    "endurance": (acts, "store", _store_uncounted, "everything", "store"),
    "reset": (power.ProcedurePower, "acknowledge", _nothing, "everything", "power"),
    "reset edge": (power.Cia402Power, "acknowledge", _nothing, "cia402", "power"),
    "among": (power.ProcedurePower, "_holds", _first_only, str(TWO_KEY), "power"),
    "limits": (preflight, "_both_ways", lambda drive, kind: [], "everything", "limits"),
    "limit of the other way": (preflight, "_both_ways", _one_way, "everything", "limits"),
    "node of the heartbeat": (
        preparation.Preparation, "watchdog", _of_another_node, str(ON_CANOPEN), "watchdog",
    ),
    "put back": (Settings, "restore", _not_put_back, "everything", "parameters.torque_up"),
    "watchdog": (preparation.Preparation, "watchdog", _empty, "cia402", "watchdog"),
    "negative sign": (Compensation, "values", _unsigned, "leadshine-el7", "compensation"),
    "conditions": (acts, "conditions", _nothing, "everything", "conditions"),
    "own estimate": (acts, "own_estimate", _nothing, "everything", "own_estimates"),
    "identity": ("commissioning.performance.clauses", "agreed", _nothing, "elmo-gold", "identity"),
    "patience": ("drivers.access", "patiently", lambda action, *_: action(), "everything", "link"),
    "patience of a mode": (
        RawAccess, "comes", lambda self, sign, patience: sign(), "everything", "patience",
    ),
    "what must not be written": (
        ProfiledDrive, "write", _other_value, "everything", "parameters.torque_source",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", LEFT_OUT)
def test_a_clause_that_the_drivers_leave_out_is_noticed(
    what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    where, name, instead, profile, section = LEFT_OUT[what]
    if isinstance(where, str):
        monkeypatch.setattr(f"{where}.{name}", instead)
    else:
        monkeypatch.setattr(where, name, instead)
    read = read_profile(str(EVERYTHING) if profile == "everything" else profile)
    assert section in sections(read)


# -- every clause of the schema -------------------------------------------------------------------

# words about the drive, and what makes no difference to what is said to it
WORDS = {
    "Profile.faults", "Profile.name", "Profile.version", "Profile.title",
    "Profile.status", "Profile.sources", "Compensation.note", "Parameter.title",
    "Parameter.source", "Parameter.nonvolatile", "Parameter.trust",
}  # fmt: skip
# for this computer, or for its mathematics: nothing of it is said to a drive; what shows it instead
ELSEWHERE = {
    "LinkDefaults.bitrate": "test_links", "LinkDefaults.sharing": "test_guardian",
    "LinkDefaults.node": "test_four_links", "LinkDefaults.service_timeout": "test_links",
    "LinkDefaults.longest_answer": "test_incoming", "Patience.boot": "test_habits",
    "LoopGains.period": "test_tune", "LoopGains.dead_time": "test_tune",
    "Compensation.acts_stored": "test_verify", "Mailbox.within": "test_wire",
}  # fmt: skip


def _models(model: type[BaseModel]) -> set[type[BaseModel]]:
    """A model and all that it is made of."""
    found = {model}
    for field in model.model_fields.values():
        for kind in _kinds(field.annotation):
            if issubclass(kind, BaseModel) and kind not in found:
                found |= _models(kind)
    return found


def _kinds(annotation: Any) -> Iterator[type]:
    parts = get_args(annotation)
    if isinstance(annotation, type) and not parts:
        yield annotation
    for part in parts:
        yield from _kinds(part)


def _said(value: object) -> Iterator[str]:
    """Clauses that a profile itself has, each as Model.field."""
    if isinstance(value, BaseModel):
        for name in value.model_fields_set:
            yield f"{type(value).__name__}.{name}"
            yield from _said(getattr(value, name))
    for one in value.values() if isinstance(value, dict) else ():
        yield from _said(one)
    for one in value if isinstance(value, tuple) else ():
        yield from _said(one)


def test_no_clause_of_the_schema_is_performed_by_no_twin() -> None:
    said = {clause for name in TRIED for clause in _said(read_profile(name))}
    every = {f"{one.__name__}.{name}" for one in _models(Profile) for name in one.model_fields}
    assert every - said - WORDS - ELSEWHERE.keys() == set()


# -- what is said of it ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        # a register behind a gap, in a block that is written
        ("register = 0x101,", "register = 0x105,", "[cycle] cannot be done"),
        # a step that never ends
        ("mask = 1, equals = 1, within = 0.2", "mask = 1, equals = 0, within = 0.2", ""),
        # a value that the type cannot hold
        ("raw = 240", "raw = 70000", "[power] writes 70000 to 'key', which takes 0…65535"),
        # a cycle that its watchdog does not bear
        ("cycle = 0.004", "cycle = 0.04", "[link] cannot be done"),
        # a wait among settings, and a setting with two values
        ('{ write = "filter", raw = 0 }', '{ until = "ready", equals = 1 }', "waits for nothing"),
        ('{ write = "filter", raw = 0 }', '{ write = "torque_source", raw = 5 }', "twice"),
        # two laws at once
        ('viscous = "viscous"', 'viscous = "viscous"\ngain = "friction_up"', "names gain, too"),
    ],
)
def test_what_cannot_be_performed_is_one_line(
    tmp_path: Path, old: str, new: str, said: str
) -> None:
    text, path = EVERYTHING.read_text("utf-8"), tmp_path / "drive.toml"
    assert text.count(old) >= 1
    path.write_text(text.replace(old, new, 1), "utf-8")
    done = in_this_process("profile", "check", str(path))
    if said:
        assert done.returncode == 2
        assert said in done.stdout + done.stderr
    assert "Traceback" not in done.stdout + done.stderr
    assert "drive.toml" in done.stderr or done.returncode == 0


@pytest.mark.parametrize(
    ("old", "new"),
    [
        # bit 15, and bits of the high word
        ("mask = 0x0F\namong = [1, 2]", "mask = 0x8000\nequals = 0"),
        ('fault = { parameter = "alarm", differs = 0 }',
         'fault = { parameter = "alarm", mask = 0x8000, differs = 0 }'),
        # a scale below zero turns the sign; a lock that is opened by 0; a setting from 2 on
        ("0.001, minimum = -300, maximum = 0", "-0.001, minimum = 0, maximum = 300"),
        ('write = "panel_lock"\nraw = 1', 'write = "panel_lock"\nraw = 0'),
        ('title = "source", protection = "experiment", forbidden = [9]',
         'title = "source", protection = "experiment", minimum = 2'),
        # a float as a base
        ('{ register = 0x530, type = "u16" }, title = "rated", unit = "N.m", scale = 0.01',
         '{ register = 0x540, type = "f32" }, title = "rated", unit = "N.m", scale = 1.0'),
    ],
)  # fmt: skip
def test_a_right_profile_is_not_called_wrong(tmp_path: Path, old: str, new: str) -> None:
    text, path = EVERYTHING.read_text("utf-8"), tmp_path / "drive.toml"
    assert text.count(old) == 1
    path.write_text(text.replace(old, new), "utf-8")
    assert [str(clause) for clause in unheard(performed(read_profile(str(path))))] == []


def test_what_takes_the_energy_must_be_there() -> None:
    findings = check(load_profile("cia402").model_copy(update={"disable": ()}))
    assert any(f.severity == "error" and "[disable] is empty" in f.text for f in findings)


def test_a_step_that_never_ends_is_said() -> None:
    profile = load_profile("leadshine-el7")
    store = profile.store
    assert store is not None
    never = store.steps[1].model_copy(update={"until": "control"})  # which cannot be read
    slow = store.model_copy(update={"steps": (store.steps[0], never)})
    found = unheard(performed(profile.model_copy(update={"store": slow})))
    assert [clause.section for clause in found] == ["store"]
    assert "1801h" in found[0].text
