"""Make safe what a dead process left energised."""

from __future__ import annotations

from threading import Thread

from commissioning.desk import Desk, connect
from commissioning.ownership import note_stop
from drivers.drive import Drive, StopReport
from drivers.errors import DriveFault, LinkError
from profiles.axis import Axis
from profiles.errors import Refused
from profiles.parameter import Protection

__all__ = ["stop"]

_FILE = 0.5  # s that a note to others may take


def stop(axis: Axis, desk: Desk) -> StopReport:
    """Make safe what a dead process left energised; raises when that is not verified."""
    with desk.interruption.deferred(), connect(axis, None, desk, "stop", to_stop=True) as drive:
        if not drive.profile.moves:
            raise Refused(
                f"profile '{drive.profile.name}' has no way to stop the drive, which says: "
                f"{drive.status_text()}; use its own controller or the emergency stop"
            )
        word = Thread(target=note_stop, args=(drive.link,), daemon=True)  # a stop waits for no file
        word.start()
        report = drive.stop(desk.interruption.hurried)
        word.join(_FILE)
        _tell_what_is_left(drive, desk)
    if report.deenergised is None:
        raise LinkError(str(report))
    if not report.deenergised:
        raise DriveFault(str(report))
    return report


def _tell_what_is_left(drive: Drive, desk: Desk) -> None:
    """Registers that the machine uses, too, and that the stop path had to write."""
    parameters, last = drive.profile.parameters, {}
    for step in (*drive.profile.stop, *drive.profile.disable):
        if step.write and parameters[step.write].protection is Protection.EXPERIMENT:
            last[step.write] = step.raw
    for name, raw in last.items():
        desk.tell(
            f"{name} ({parameters[name].address}) is left at {raw}: set it as the machine needs it"
        )
