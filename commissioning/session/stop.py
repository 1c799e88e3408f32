"""Make safe what a dead process left energised."""

from __future__ import annotations

from threading import Thread

from commissioning.desk import Desk, connect
from commissioning.ownership import note_stop
from drivers.drive import Drive, StopReport
from drivers.errors import DriveFault, LinkError
from profiles.axis import Axis
from profiles.errors import Refused

__all__ = ["stop"]

_FILE = 0.5  # s that a note to others may take


def stop(axis: Axis, desk: Desk) -> StopReport:
    """Make safe what a dead process left energised; raises when that is not verified."""
    with desk.interruption.deferred(), connect(axis, None, desk, "stop", to_stop=True) as drive:
        if not drive.moves:
            raise Refused(
                f"{drive.profile} has no way to stop the drive, which says: {drive.state().text}",
                code="stop.no-way",
                hint="use its own controller or the emergency stop",
            )
        word = Thread(target=note_stop, args=(drive.link,), daemon=True)  # a stop waits for no file
        word.start()
        report = drive.stop(desk.interruption.hurried)
        word.join(_FILE)
        _tell_what_is_left(drive, desk)
    if report.deenergised is None:
        raise LinkError(str(report), code="stop.not-verified")
    if not report.deenergised:
        raise DriveFault(str(report), code="stop.energised")
    return report


def _tell_what_is_left(drive: Drive, desk: Desk) -> None:
    """Registers that the machine uses, too, and that the stop path had to write."""
    for name, raw in drive.preparation.left_by_a_stop().items():
        address = drive.parameters[name].address
        desk.tell(f"{name} ({address}) is left at {raw}: set it as the machine needs it")
