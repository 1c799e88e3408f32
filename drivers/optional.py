"""What not every drive has: its profile without the objects that this one lacks, and what that means."""

from __future__ import annotations

from collections.abc import Callable

from profiles.schema import Address, Profile

__all__ = ["as_it_is"]


def as_it_is(profile: Profile, has: Callable[[Address], bool]) -> tuple[Profile, tuple[str, ...]]:
    """The profile for the drive that is there, and a line about each thing that it cannot do.

    Its parameters stay; what a job would do with those that are missing is left out. `has` asks the drive.
    """
    changes: dict[str, object] = {}
    lines: list[str] = []

    def lacks(name: str | None) -> bool:
        return name is not None and not has(profile.parameters[name].address)

    limits = {kind: name for kind, name in profile.limits.items() if not lacks(name)}
    for kind in profile.limits.keys() - limits.keys():
        at = profile.parameters[profile.limits[kind]].address
        lines.append(f"the drive has no {kind} limit ({at}): only this computer limits it")
    if lines:
        changes["limits"] = limits
    if "torque_actual" in profile.cycle.in_ and lacks("torque_actual"):
        into = tuple(name for name in profile.cycle.in_ if name != "torque_actual")
        changes["cycle"] = profile.cycle.model_copy(update={"in_": into})
        lines.append("the drive does not tell its torque (6077h): it is not watched")
    watchdog = profile.watchdog
    if lacks(watchdog.parameter):
        changes["watchdog"] = watchdog.model_copy(update={"kind": "none", "parameter": None})
        at = profile.parameters[watchdog.parameter or ""].address
        lines.append(
            f"the drive has no watchdog of communication ({at}): it does not notice a dead link"
        )
    elif lacks(watchdog.reaction):
        changes["watchdog"] = watchdog.model_copy(update={"reaction": None, "reaction_raw": None})
        at = profile.parameters[watchdog.reaction or ""].address
        lines.append(
            f"what the drive does when the link is dead cannot be set ({at}): its proof shows it"
        )
    return (profile.model_copy(update=changes) if changes else profile), tuple(lines)
