"""What goes into a drive's non-volatile memory, and what may be written at all."""

from __future__ import annotations

from commissioning.desk import Desk
from commissioning.journal import RESTORED, STORED, STORING
from drivers.drive import Drive
from drivers.errors import WriteFailed
from profiles.errors import Refused, TwoRelayError
from profiles.parameter import Trust, Unit
from profiles.schema import Profile

__all__ = ["store", "storing", "unverified"]


def storing(profile: Profile, *, prove_first: bool) -> tuple[bool, str]:
    """Whether a store follows the writes, and what the user is told."""
    if profile.store is None:
        return not prove_first, "and are lost at power-off: the profile has no store procedure"
    if not prove_first:
        return True, "and stored"
    return False, "in its RAM, and stored once they are proved"


def unverified(profile: Profile, names: list[str], *, constant_known: bool) -> None:
    """Raise Refused where a value would go to an address, or be scaled by a base, that nobody verified."""
    parameters = {name: profile.parameters[name] for name in names}
    doubtful = [
        f"{name} ({parameter.address})"
        for name, parameter in parameters.items()
        if parameter.trust is Trust.UNVERIFIED
    ]
    base = profile.parameters.get("rated_current")
    currents = [name for name, parameter in parameters.items() if parameter.unit is Unit.CURRENT]
    if currents and not constant_known and base is not None and base.trust is Trust.UNVERIFIED:
        raise Refused(
            f"{', '.join(currents)} is a current, and profile '{profile.name}' marks the rated current "
            f"({base.address}) unverified: nothing was written. Give torque_constant (N.m/A of the motor) in "
            "the axis file"
        )
    if doubtful:
        raise Refused(
            f"profile '{profile.name}' marks {', '.join(doubtful)} unverified: nothing was written. Check "
            "the drive's manual, mark them verified in a copy of the profile (tworelay profile show), and "
            "identify with that"
        )


def store(
    drive: Drive, desk: Desk, run_id: str, wanted: dict[str, int], text: str = STORED
) -> None:
    """Store, and see that the raw values `wanted` are still there; raises WriteFailed.

    `text` : STORED, or RESTORED where they are those from before the run
    """
    procedure = drive.profile.store
    if procedure is None:
        desk.tell(
            f"profile '{drive.profile.name}' has no store procedure: the values are lost at power-off"
        )
        return
    before, most = desk.journal.stores(run_id), procedure.endurance
    if before >= most:
        raise WriteFailed(
            f"this drive has stored {before} times from here, and its memory takes about {most}: the values "
            "are in effect, and not stored; store them with the maker's software if its memory is new"
        )
    desk.journal.note_stored(run_id, STORING)  # should this be cut off, `restore` must store
    try:
        drive.store()
    except TwoRelayError as error:
        error.args = (f"{error}; not known to be stored: {', '.join(wanted)}",)
        raise
    desk.journal.note_stored(run_id, text)
    for name, raw in wanted.items():
        there = drive.read_raw(name)
        if there != raw:
            raise WriteFailed(f"'{name}' reads {there} after the store, not {raw}")
    what = "the old values are stored" if text == RESTORED else "stored"
    desk.tell(
        f"{what} in the drive's non-volatile memory, read back again (store {before + 1} of this drive from "
        f"here; such a memory takes about {most})"
    )
