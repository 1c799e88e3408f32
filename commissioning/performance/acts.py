"""Everything that a profile describes, done to its own twin, and overheard.

The acts are the product's own: what a job does to a drive, and what it does not do, shows here.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace
from pathlib import Path

from commissioning.compensation import propose
from commissioning.desk import Desk, Options, begin_run
from commissioning.guardian import NOBODY
from commissioning.interruption import Interruption
from commissioning.journal import Journal
from commissioning.performance.trying import (
    CYCLES,
    FRACTION,
    FRICTION,
    WornJournal,
    another,
    like,
    not_allowed,
    to_both_sides,
    unlike,
)
from commissioning.rig.conditions import conditions
from commissioning.rig.preflight import choose_limits, look
from commissioning.rig.rig import Rig
from commissioning.runner import Recorder, verified
from commissioning.session.proposal import own_estimate
from commissioning.session.storing import store
from commissioning.settings import Settings, put_back
from drivers.twinned import Twinned, open_twin, virtual_axis
from drivers.virtual.habits import NONE, Habits
from drivers.virtual.witness import Utterance
from profiles.axis import Axis, Mechanics
from profiles.errors import ProfileError, TwoRelayError
from profiles.parameter import Access, Protection, Trust, Unit
from profiles.procedures import Condition, Mode, ModeCode, writes_of
from profiles.schema import Profile

__all__ = ["Account", "performed", "tried_axis"]

_LIMITED = 0.5  # of the rated torque: less than any drive is delivered with
_SHARE = 0.05  # of the largest torque: the axis does not move for it
_COUNTS = 20  # of a motion in position mode
_STILL_BUSY = 0x8611  # following error: an error code that any twin can have


@dataclass
class Account:
    """What was said to the twin, act by act.

    Attributes
    ----------
    said : by act, in its order
    trouble : what an act has ended with, where it has not come to its end
    told : what the drive said of itself, or how long something took, s, by a name of the act's own
    functions : Modbus functions that were asked for, by act
    identifiers : of the frames that were sent, on CANopen
    delivered, left : raw values of what a job may write, before and after one
    """

    profile: Profile
    said: dict[str, list[Utterance]] = field(default_factory=dict)
    trouble: dict[str, TwoRelayError] = field(default_factory=dict)
    told: dict[str, object] = field(default_factory=dict)
    functions: dict[str, set[int]] = field(default_factory=dict)
    identifiers: set[int] = field(default_factory=set)
    delivered: dict[str, float] = field(default_factory=dict)
    left: dict[str, float] = field(default_factory=dict)

    def writes(self, act: str) -> list[tuple[str, float]]:
        """Names and raw values of what was written in an act, in its order."""
        return [(one.name, one.raw) for one in self.said.get(act, ()) if one.act == "write"]

    def reads(self, act: str) -> set[str]:
        """Names of what was read in an act."""
        return {one.name for one in self.said.get(act, ()) if one.act == "read"}


def tried_axis(profile: Profile) -> Axis:
    """The axis before the twin: what the profile does not tell is in its file."""
    axis, known = virtual_axis(), profile.parameters
    current = any(p.unit is Unit.CURRENT for name, p in known.items() if name != "rated_current")
    return Axis(
        name="check",
        travel=axis.travel,
        rated_torque=None if "rated_torque" in known else axis.rated,
        encoder=None if "encoder_increments" in known else axis.encoder,
        mechanics=Mechanics(gear=1.0),
        torque_constant=axis.rated / 2 if current and "rated_current" not in known else None,
    )


def performed(profile: Profile) -> Account:
    """Every act once; what each said. Only the profile's own values are used, and no wall clock."""
    heard = Account(profile)
    with tempfile.TemporaryDirectory() as folder, Journal(Path(folder)) as journal:
        desk = Desk(journal, Interruption(), lambda text: None, lambda question, word: True)
        try:
            _perform(heard, desk, profile)
        except TwoRelayError as error:  # between two acts
            heard.trouble.setdefault("profile", error)
    return heard


def _perform(heard: Account, desk: Desk, profile: Profile) -> None:
    bench = _opened(heard, desk, profile)
    if bench is None:
        return
    heard.delivered = bench.values()
    bench.reading()
    if profile.moves:
        bench.job()
        heard.left = bench.values()
        if heard.trouble:  # what follows would only follow from it
            return
        bench.reset()
        bench.quick_stop()
    bench.writing()
    bench.guarding()
    bench.requiring()
    if profile.moves:
        bench.saying()
        bench.impatience()
        _alternatives(heard, desk, profile)


def _trusted(profile: Profile) -> Profile:
    """The profile as if all of it were verified: that it is performed does not make it true."""
    known = {
        name: one.model_copy(update={"trust": Trust.VERIFIED})
        for name, one in profile.parameters.items()
    }
    return profile.model_copy(update={"parameters": known})


def _opened(
    heard: Account, desk: Desk, profile: Profile, act: str = "open", habits: Habits = NONE
) -> _Bench | None:
    try:
        twinned = open_twin(_trusted(profile), tried_axis(profile), habits)
        heard.said[act] = twinned.witness.said.copy()
        heard.functions[act] = set(twinned.witness.functions)
        return _Bench(heard, desk, twinned, tried_axis(profile))
    except TwoRelayError as error:
        heard.trouble[act] = error
        return None


def _alternatives(heard: Account, desk: Desk, profile: Profile) -> None:
    """The other codes of a mode, each on a drive that has no other one; and life guarding."""
    for mode, codes in profile.modes.items():
        for number, code in enumerate(codes[1:], 2):
            modes: dict[Mode, tuple[ModeCode, ...]] = {**profile.modes, mode: (code,)}
            variant, act = profile.model_copy(update={"modes": modes}), f"modes.{mode} {number}"
            bench = _opened(heard, desk, variant, act)
            if bench is not None:
                bench.job(f" of {act}")
    if profile.watchdog.guard_time is not None:
        bench = _opened(heard, desk, profile, "guarding", Habits({"guarding": ""}))
        if bench is not None:
            bench.job(" of guarding")


@dataclass
class _Bench:
    """One twin and what is done to it."""

    heard: Account
    desk: Desk
    twinned: Twinned
    axis: Axis

    def __post_init__(self) -> None:
        self.drive = self.twinned.drive
        self.profile = self.drive.profile
        self.witness = self.twinned.witness
        axis = self.axis
        self.run = begin_run(self.desk, self.drive, self.drive.identity(), axis, FRACTION)
        self.settings = Settings(self.desk.journal, self.run, self.drive)

    @contextlib.contextmanager
    def act(self, name: str) -> Generator[None]:
        """What is said meanwhile is of that act; what ends it is its trouble."""
        begin = len(self.witness.said)
        self.witness.functions.clear()
        try:
            yield
        except TwoRelayError as error:
            self.heard.trouble.setdefault(name, error)
        finally:
            self.heard.said.setdefault(name, []).extend(self.witness.said[begin:])
            self.heard.functions.setdefault(name, set()).update(self.witness.functions)
            if self.twinned.adapter is not None:
                self.heard.identifiers |= self.twinned.adapter.sent
            self.witness.forced.clear()
            self.witness.deaf.clear()
            self.witness.busy.clear()

    @property
    def now(self) -> float:
        """Time of the drive, s."""
        return self.witness.now()

    def values(self) -> dict[str, float]:
        """What can be read, and does not change by itself."""
        found = {}
        begin = len(self.witness.said)
        for name, parameter in self.profile.parameters.items():
            if parameter.protection not in (Protection.READ, Protection.MAINTENANCE):
                with contextlib.suppress(TwoRelayError):
                    found[name] = float(self.drive.read(name).raw)
        del self.witness.said[begin:]
        return found

    # -- acts ------------------------------------------------------------------------------------

    def reading(self) -> None:
        """Each parameter that can be read, and what is asked of a drive without a job."""
        for name, parameter in self.profile.parameters.items():
            if parameter.access is not Access.WRITE_ONLY:
                with self.act(f"read {name}"):
                    self.drive.read(name)
        with self.act("conditions"):
            conditions(self.drive, self.axis, 0.0, None)
            own_estimate(self.drive, 1.0)

    def job(self, of: str = "") -> None:
        """A job of its own, without the experiments: looked at, prepared, moved, put back."""
        # a fault that cannot be acknowledged stays after the proof of a watchdog
        power = self.profile.power
        none = self.profile.watchdog.kind == "none" or (power is not None and not power.reset)
        virtual = virtual_axis()
        options = Options(
            max_speed=virtual.speed,
            max_torque=_LIMITED * virtual.rated,
            without_watchdog=none,
        )
        with self.act("look" + of):
            look(self.drive, self.axis)
            limits = choose_limits(self.drive, self.axis, options)
            recorder = Recorder()
            rig = Rig.of(
                self.axis, options, self.desk, self.drive, limits, recorder, self.settings, NOBODY
            )
            parts: list[tuple[str, Callable[[], object]]] = [
                ("torque", lambda: self._pushed(rig)),
                ("widen", lambda: rig.mover.widen(limits.speed)),
            ]
            if self.profile.modes.get(Mode.POSITION):
                parts.append(("position", lambda: self._followed(rig)))

            def work() -> None:
                self._cut("prepare" + of, begin)
                for name, part in parts:
                    with self.act(name + of):
                        part()
                self._back = len(self.witness.said)

            begin = len(self.witness.said)
            try:
                rig.mover.within_settings(work)
            except TwoRelayError as error:
                self.heard.trouble.setdefault("prepare" + of, error)
                self._cut("prepare" + of, begin)
                return
            self._cut("back" + of, self._back)

    def _cut(self, name: str, begin: int) -> None:
        self.heard.said[name] = self.witness.said[begin:]

    def _pushed(self, rig: Rig) -> None:
        torque = max(_SHARE * rig.limits.torque, 2 * abs(rig.context.torque_resolution))
        rig.mover.move(to_both_sides(torque), rig.envelope, 0.0)

    def _followed(self, rig: Rig) -> None:
        way = _COUNTS * rig.context.resolution
        envelope = replace(rig.envelope, cautious=False)
        rig.mover.follow(lambda here: to_both_sides(way, here), envelope, Recorder())

    def reset(self) -> None:
        """A fault comes up, and is acknowledged."""
        power = self.profile.power
        if power is not None and (power.fault is None or not power.reset):
            return
        with self.act("reset"):
            self.twinned.firmware.trip(_STILL_BUSY)
            self.heard.told["in fault"] = self.drive.state().in_fault
            self.drive.reset_fault()
            self.heard.told["after reset"] = self.drive.state().in_fault

    def quick_stop(self) -> None:
        """The stop path, from a drive that is enabled; then from one that does not heed it."""
        ends = set(writes_of(self.profile.disable))
        stopping = set(writes_of(self.profile.stop)) - ends
        with self._prepared():
            with self.act("stop"):
                self._enabled()
                verified(self.drive.stop(), None)
            with self.act("deaf stop"):
                self._enabled()
                self.twinned.firmware.values["watchdog_time"] = 0  # which would stop it, too
                self.witness.deaf |= stopping
                began = self.now
                self.drive.stop()
                times = [
                    one.time
                    for one in self.witness.said
                    if one.act == "write" and (one.name, one.raw) in ends and one.time >= began
                ]
                if stopping and times:
                    self.heard.told["stop time"] = min(times) - began
            if self.drive.state().in_fault:
                self.drive.reset_fault()

    @contextlib.contextmanager
    def _prepared(self) -> Generator[None]:
        """What the torque mode needs, in the drive."""
        wanted = self.drive.preparation.settings(Mode.TORQUE)
        old = {name: self.drive.read(name).raw for name in wanted}
        for name, raw in wanted.items():
            self.drive.write(name, raw)
        yield
        for name in reversed(old):
            self.drive.write(name, old[name])

    def _enabled(self) -> None:
        self.drive.enable(Mode.TORQUE)
        for _ in range(CYCLES):
            self.drive.exchange(0.0)

    def writing(self) -> None:
        """What `apply` writes and stores, the gains, and the way back."""
        law, loops = self.profile.compensation, self.profile.loops
        parameters = self.drive.parameters
        with self.act("apply"), self.settings.exclusive_access():
            old = {name: self.drive.read(name).raw for name in law.terms.values()}
            for change in propose(law, parameters, FRICTION, old, FRACTION):
                self.settings.write("compensation", change.parameter, change.new_raw)
        with self.act("gains"), self.settings.exclusive_access():
            for name in loops.terms.values() if loops else ():
                there = self.drive.read(name).raw
                self.settings.write("gain", name, another(parameters[name].parameter, there))
        with self.act("store"):
            store(self.drive, self.desk, self.run, {})
        with self.act("worn"):
            if self.profile.store is not None:
                most = self.profile.store.endurance
                self.heard.told["worn"] = self._stores_once_more(most)
        with self.act("undo"), self.settings.exclusive_access():
            intents = self.desk.journal.intents(self.run, open_only=True)
            outcome = put_back(self.drive, [one for one in intents if one.lasts])
            if not outcome.complete:
                raise ProfileError(f"what was written is not put back: {outcome}")

    def _stores_once_more(self, most: int) -> bool:
        """Whether a drive that has stored so many times stores once more."""
        journal = self.desk.journal
        worn = replace(self.desk, journal=WornJournal(journal, most))  # type: ignore[arg-type]
        try:
            store(self.drive, worn, self.run, {})
        except TwoRelayError as error:
            return error.code != "store.worn"
        return True

    def guarding(self) -> None:
        """What must not be written is not: what is beyond its range, forbidden, or read only."""
        for name, parameter in self.profile.parameters.items():
            for raw in not_allowed(parameter):
                with self.act(f"guard {name}"):
                    self.drive.write(name, raw)

    def requiring(self) -> None:
        """What is required, and the master for whom it swaps words, put into the drive's mouth."""
        known = self.profile.parameters
        for number, condition in enumerate(self.profile.requires):
            with self.act(f"requires {number}"):
                wrong = unlike(condition, known[condition.parameter])
                self.witness.forced[condition.parameter] = wrong
                self.drive.preparation.check_conditions()
        with self.act("word order"):
            self.drive.preparation.check_word_order()

    def saying(self) -> None:
        """Each sign of the power stage put into the drive's mouth."""
        power = self.profile.power
        for mode, codes in self.profile.modes.items():
            for number, code in enumerate(codes, 1):
                if code.supported_bit is not None and "supported_modes" in self.profile.parameters:
                    with self.act(f"supported {mode} {number}"):
                        self.witness.forced["supported_modes"] = 1 << code.supported_bit
                        self.drive.preparation.settings(mode)
                        self.heard.told[f"code {mode} {number}"] = (
                            self.drive.preparation.code_of(mode) == code.code
                        )
        if power is not None:
            for sign in ("enabled", "stopping", "fault"):
                sense: Condition | None = getattr(power, sign)
                if sense is not None:
                    self._signs(sign, sense)
        with self.act("compensation at work"):
            self.witness.forced |= dict.fromkeys(self.profile.compensation.terms.values(), 1)
            look(self.drive, self.axis)
        host = self.profile.compensation.host
        if host is not None:
            with self.act("host"):
                self.witness.forced[host] = 1
                self.heard.told["host"] = self.drive.preparation.settings(Mode.TORQUE).get(host)

    def _signs(self, sign: str, condition: Condition) -> None:
        parameter = self.profile.parameters[condition.parameter]
        there = condition.wanted or (like(condition, parameter),)
        found = []
        with self.act(f"says {sign}"):
            for raw, holds in [
                *((raw, True) for raw in there),
                (unlike(condition, parameter), False),
            ]:
                self.witness.forced[condition.parameter] = raw
                said = self.drive.state()
                heard = said.in_fault if sign == "fault" else said.is_energised
                if holds or not self._other_sign(sign, condition.parameter, raw):
                    found.append(heard is holds)
        self.heard.told[f"says {sign}"] = bool(found) and all(found)

    def _other_sign(self, sign: str, name: str, raw: int) -> bool:
        """Whether another condition gives the same sign for that value."""
        power = self.profile.power
        assert power is not None
        others = {"enabled": power.stopping, "stopping": power.enabled}.get(sign)
        return others is not None and others.parameter == name and others.holds(raw)

    def impatience(self) -> None:
        """A drive that never does what it was told: how long it is borne with, s of its clock.

        Only what the profile says itself: its times are otherwise the same for each drive.
        """
        said = self.profile.patience.model_fields_set
        if "patience" in self.profile.link.model_fields_set:
            self._borne("link.patience", lambda: self.drive.read("position_actual"),
                        busy="position_actual")  # fmt: skip
        code, parameters = self.profile.modes[Mode.TORQUE][0].code, self.profile.parameters
        if "mode" in said and code is not None:
            shown = "mode_display" if "mode_display" in parameters else "mode_of_operation"
            self._borne("patience.mode", lambda: self.drive.enable(Mode.TORQUE),
                        forced={shown: code ^ 1})  # fmt: skip
        power = self.profile.power
        if "enable" in said:
            on = {("controlword", 0x0F)} if power is None else set(writes_of(power.enable[-1:]))
            self._borne("patience.enable", lambda: self.drive.enable(Mode.TORQUE), deaf=on)
            self.drive.stop()
        acknowledged = {("controlword", 0x80)} if power is None else set(writes_of(power.reset))
        if power is not None and any(step.until is not None for step in power.reset):
            acknowledged = set()  # which has a time of its own
        if "reset" in said and acknowledged:
            self.twinned.firmware.trip(_STILL_BUSY)
            self._borne("patience.reset", self.drive.reset_fault, deaf=acknowledged)
            self.drive.reset_fault()
        steps = self.profile.store.steps if self.profile.store else ()
        first = next((step.write for step in steps if step.write is not None), None)
        if "save" in said and first is not None:
            self._borne("patience.save", self.drive.store, busy=first)

    def _borne(
        self,
        what: str,
        action: Callable[[], object],
        *,
        busy: str | None = None,
        deaf: set[tuple[str, int]] | None = None,
        forced: dict[str, int] | None = None,
    ) -> None:
        began = self.now
        with self.act(what):
            self.witness.deaf |= deaf or set()
            self.witness.forced |= forced or {}
            self.witness.busy |= {busy} if busy else set()
            try:
                action()
            finally:
                self.heard.told[what] = self.now - began
