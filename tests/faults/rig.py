"""A short job through a wire that breaks it, and everything that must hold afterwards."""

from __future__ import annotations

from pathlib import Path

from commissioning.desk import Desk, Options
from commissioning.experiments.approach import approach
from commissioning.experiments.design import SHORT
from commissioning.experiments.oscillations import Oscillations, Stretch, oscillations
from commissioning.experiments.plan import Plan
from commissioning.interruption import Interruption
from commissioning.journal import Journal
from commissioning.result.document import RunResult
from commissioning.rig.armed import Failure, in_a_run
from commissioning.rig.ready import Ready
from commissioning.rig.rig import Rig as Bench
from commissioning.session.identify import identify
from commissioning.session.restore import restore
from drivers.link import open_can, open_drive, parse
from profiles.axis import Axis
from tests.faults.proxy import NEED_NO_ANSWER, WIRES, Proxy, Way, drive_end

__all__ = ["Rig", "ways"]

PDO = (
    (0x1400, 1), (0x1400, 2), (0x1600, 0), (0x1600, 1), (0x1800, 1), (0x1800, 2), (0x1A00, 0),
    (0x1A00, 1),
    (0x1017, 0),
)  # fmt: skip
ALLOWED = {3, 4, 5, 6, 7}  # refused, link, drive stopped, rejected, not put back: never a bug (1)
_CYCLE, _TRAVEL = 0.015, 3.0  # s, rad
_PATIENCE = 0.05  # s for an answer


def ways(answered: list[bool]) -> list[tuple[int, Way]]:
    """Every case of a job whose transactions are answered so."""
    return [
        (at, way)
        for at, is_answered in enumerate(answered)
        for way in Way
        if is_answered or way in NEED_NO_ANSWER
    ]


def short(rig: Bench, result: RunResult) -> RunResult:
    """Every phase of a measurement in less than 300 cycles, and nothing evaluated."""

    def plan(ready: Ready) -> Plan[Oscillations]:
        sample = yield ready.known.offset
        begin = sample.position + 0.025 * _TRAVEL
        yield from approach(ready.context, begin, ready.known)
        return (
            yield from oscillations(
                ready.context, ready.design, ready.known, 2, (Stretch(2, 1, 1),)
            )
        )

    def work() -> None:
        ready = rig.prepare(SHORT)
        ready.run(plan(ready))

    rig.mover.within_settings(work)
    return result


class Rig:
    """A served drive, and jobs on it through a wire that breaks.

    Parameters
    ----------
    links : of the drive: by Modbus TCP, to look at it, and on the wire
    whole : the whole job, and not the short one
    """

    def __init__(self, links: list[str], wire: str, home: Path, *, whole: bool = False) -> None:
        self.wire = WIRES[wire]
        self.whole = whole
        patient = f"{links[0]}&timeout=2"
        profile = self.wire.profile if self.wire.is_own else "virtual-modbus"
        self._watch = open_drive(Axis(link=patient, profile=profile))
        self.direct = f"{links[-1]}&timeout=2"
        self.home = home
        self.before = self.look()

    def look(self) -> dict[str, int]:
        """Parameters of the drive, after time enough for its own watchdog.

        It must be de-energised.
        """
        watch = self._watch
        watch.wait(0.2)
        assert not watch.state().is_energised, "the axis is energised"
        if watch.state().in_fault:
            watch.reset_fault()
        watch.wait(2.0)  # it coasts to rest before the next case
        if "canopen" not in self.direct:
            return {name: watch.read(name).raw for name in self.wire.watched}
        drive = open_drive(Axis(link=self.direct, profile=self.wire.profile))
        try:
            found = {name: drive.read(name).raw for name in self.wire.watched}
        finally:
            drive.close()
        return found | self._look_at_pdos()

    def close(self) -> None:
        """Look no more."""
        self._watch.close()

    def _look_at_pdos(self) -> dict[str, int]:
        from drivers.canopen.wire import CanWire

        wire = CanWire(open_can(parse(self.direct)), 5, 2.0)
        try:
            return {
                f"{index:04X}h:{sub:02X}": int.from_bytes(wire.upload(index, sub)[:4], "little")
                for index, sub in PDO
            }
        finally:
            wire.close()

    def case(self, at: int | None, way: Way) -> tuple[list[bool], int]:
        """One job; returns (answered, exit code), after everything that must hold was checked."""
        proxy = Proxy(self.wire, drive_end(self.direct), at, way)
        link = f"{self.wire.link.format(proxy.place)}&clock=step&timeout={_PATIENCE}"
        axis = Axis(link=link, profile=self.wire.profile, travel=_TRAVEL)
        options = Options(
            travel=20.0 if self.whole else _TRAVEL,
            max_torque=2.9,
            cycle=_CYCLE,
            method="modulating",
        )
        lines: list[str] = []
        code = 0
        try:
            with Journal(self.home) as journal:
                desk = Desk(journal, Interruption(), lines.append, lambda question, word: True)
                try:
                    if self.whole:
                        identify(axis, options, desk)
                    else:
                        in_a_run(axis, options, desk, short)
                except Failure as failure:
                    code = failure.error.exit_code
                    text = str(failure.error)
                    assert code in ALLOWED, text
                    assert len(text.splitlines()) == 1
                answered = list(proxy.answered)
        finally:
            proxy.close()
        after = self.look()
        with Journal(self.home) as journal:
            changed = {name for name, value in after.items() if value != self.before[name]}
            run = journal.run("last").id if journal.open_runs() else None
            named = {i.parameter for i in journal.intents(run, open_only=True)} if run else set()
            assert changed <= named, f"changed and in no journal: {changed - named}"
            assert not changed or code, "a job that says nothing left settings changed"
            if run:
                desk = Desk(journal, Interruption(), lines.append, lambda question, word: True)
                outcome = restore(run, self.direct, desk, force=False)
                assert outcome.complete, str(outcome)
            assert not journal.open_runs()
        now = self.look() if run else after
        wrong = {n: (now[n], was) for n, was in self.before.items() if now[n] != was}
        assert not wrong, f"not restored (now, before): {wrong}; {lines[-3:]}"
        return answered, code
