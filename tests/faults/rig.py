"""A job through a proxy that breaks it, and everything that must hold afterwards."""

from __future__ import annotations

from pathlib import Path

from commissioning.interruption import Interruption
from commissioning.journal import Journal
from commissioning.session.apply import restore
from commissioning.session.armed import Failure
from commissioning.session.desk import Desk, Options
from commissioning.session.identify import identify
from drivers.link import open_drive
from profiles.axis import Axis
from tests.faults.proxy import Proxy, Way

__all__ = ["Rig"]

SHORT = Options(travel=20.0, cycle=0.015, method="modulating")
WATCHED = (
    "max_torque", "max_speed", "abort_connection_option", "quick_stop_option", "watchdog_time",
    "mode_of_operation", "torque_target", "coulomb_positive", "coulomb_negative",
    "viscous_gain", "torque_offset",
)  # fmt: skip
ALLOWED = {3, 4, 5, 6, 7}  # refused, link, drive stopped, rejected, not put back: never a bug (1)


class Rig:
    """A served drive, and jobs on it through a proxy."""

    def __init__(self, link: str, home: Path) -> None:
        self.direct = Axis(link=f"{link}&timeout=2", profile="virtual-modbus", travel=20.0)
        self.port = int(link.split(":")[2].split("?", maxsplit=1)[0])
        self.home = home
        self.before = self.look()

    def look(self) -> dict[str, int]:
        """Parameters of the drive, after time enough for its own watchdog; it must be de-energised."""
        drive = open_drive(self.direct)
        try:
            drive.wait(0.2)
            assert not drive.is_energised(), "the axis is energised"
            if drive.in_fault():
                drive.reset_fault()
            drive.wait(2.0)  # it coasts to rest before the next case
            return {name: drive.read_raw(name) for name in WATCHED}
        finally:
            drive.close()

    def case(self, at: int | None, way: Way) -> tuple[int, int]:
        """One job; returns (transactions, exit code), after everything that must hold was checked."""
        proxy = Proxy(self.port, at, way)
        link = f"modbus-tcp://127.0.0.1:{proxy.port}?unit=1&clock=step&timeout=0.05"
        axis = self.direct.model_copy(update={"link": link})
        lines: list[str] = []
        code = 0
        try:
            with Journal(self.home) as journal:
                desk = Desk(journal, Interruption(), lines.append, lambda question, word: True)
                try:
                    identify(axis, SHORT, desk)
                except Failure as failure:
                    code = failure.error.exit_code
                    text = str(failure.error)
                    assert code in ALLOWED, text
                    assert len(text.splitlines()) == 1
                count = proxy.count
        finally:
            proxy.close()
        after = self.look()
        with Journal(self.home) as journal:
            changed = {name for name in WATCHED if after[name] != self.before[name]}
            run = journal.run("last").id if journal.open_runs() else None
            named = {i.parameter for i in journal.intents(run, open_only=True)} if run else set()
            assert changed <= named, f"changed and in no journal: {changed - named}"
            assert not changed or code, "a job that says nothing left settings changed"
            if run:
                desk = Desk(journal, Interruption(), lines.append, lambda question, word: True)
                outcome = restore(run, self.direct.link, desk, force=False)
                assert outcome.complete, str(outcome)
            assert not journal.open_runs()
        now = self.look()
        wrong = {
            name: (now[name], self.before[name])
            for name in WATCHED
            if now[name] != self.before[name]
        }
        assert not wrong, f"not restored (now, before): {wrong}; {lines[-3:]}"
        return count, code
