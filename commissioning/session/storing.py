"""What goes into a drive's non-volatile memory, and what may be written at all."""

from __future__ import annotations

from commissioning.desk import Desk
from commissioning.journal import RESTORED, STORED, STORING
from drivers.drive import Drive
from drivers.errors import WriteFailed
from drivers.writing import why_not_written
from profiles.errors import Refused, TwoRelayError

__all__ = ["all_writable", "store", "storing"]


def storing(drive: Drive, *, prove_first: bool) -> tuple[bool, str]:
    """Whether a store follows the writes, and what the user is told."""
    if drive.memory is None:
        return not prove_first, "and are lost at power-off: the profile has no store procedure"
    if not prove_first:
        return True, "and stored"
    return False, "in its RAM, and stored once they are proved"


def all_writable(drive: Drive, names: list[str]) -> None:
    """Raise Refused where one of the parameters may not be written for good."""
    found = {name: why_not_written(drive.parameters[name]) for name in names}
    refused = {name: why for name, why in found.items() if why is not None}
    if refused:
        ways = dict.fromkeys(why.hint for why in refused.values() if why.hint)
        raise Refused(
            f"{'; '.join(why.text for why in refused.values())}: nothing was written",
            code=next(iter(refused.values())).code,
            hint="; ".join(ways),
            parameter=", ".join(refused),
        )


def store(
    drive: Drive, desk: Desk, run_id: str, wanted: dict[str, int], text: str = STORED
) -> None:
    """Store, and see that the raw values `wanted` are still there; raises WriteFailed.

    `text` : STORED, or RESTORED where they are those from before the run
    """
    procedure = drive.memory
    if procedure is None:
        desk.tell(f"{drive.profile} has no store procedure: the values are lost at power-off")
        return
    before, most = desk.journal.stores(run_id), procedure.endurance
    if before >= most:
        raise WriteFailed(
            f"this drive has stored {before} times from here, and its memory takes about {most}: "
            "the values are in effect, and not stored",
            code="store.worn",
            value=before,
            limit=most,
            hint="store them with the maker's software if its memory is new",
        )
    desk.journal.note_stored(run_id, STORING)  # should this be cut off, `restore` must store
    try:
        drive.store()
    except TwoRelayError as error:
        error.also(f"not known to be stored: {', '.join(wanted)}")
        raise
    desk.journal.note_stored(run_id, text)
    for name, raw in wanted.items():
        there = drive.read(name).raw
        if there != raw:
            raise WriteFailed(
                f"'{name}' reads {there} after the store, not {raw}",
                code="store.read-back",
                parameter=name,
                value=there,
                wanted=raw,
            )
    what = "the old values are stored" if text == RESTORED else "stored"
    desk.watcher.phase(
        f"{what} in the drive's non-volatile memory, read back again (store {before + 1} of this "
        f"drive from here; such a memory takes about {most})"
    )
