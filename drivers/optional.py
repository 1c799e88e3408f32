"""What not every drive has.

Its profile without the objects that this one lacks, and what that means.
"""

from __future__ import annotations

from collections.abc import Callable

from profiles.address import Address
from profiles.procedures import Watchdog
from profiles.schema import Profile

__all__ = ["as_it_is"]


def as_it_is(
    profile: Profile, has: Callable[[Address], bool], *, can_guard: bool
) -> tuple[Profile, tuple[str, ...]]:
    """The profile for the drive that is there, and a line about each thing that it cannot do.

    Its parameters stay; what a job would do with those that are missing is left out. `has` asks the
    drive; `can_guard`: the link carries the remote frames of life guarding.
    """
    changes: dict[str, object] = {}
    lines: list[str] = []

    def lacks(name: str | None) -> bool:
        return name is not None and not has(profile.parameters[name].address)

    limits = {kind: name for kind, name in profile.limits.items() if not lacks(name)}
    for kind in profile.limits.keys() - limits.keys() - {"current"}:  # which few have
        at = profile.parameters[profile.limits[kind]].address
        lines.append(f"the drive has no {kind} limit ({at}): only this computer limits it")
    if limits != profile.limits:
        changes["limits"] = limits
    if "torque_actual" in profile.cycle.in_ and lacks("torque_actual"):
        into = tuple(name for name in profile.cycle.in_ if name != "torque_actual")
        changes["cycle"] = profile.cycle.model_copy(update={"in_": into})
        lines.append("the drive does not tell its torque (6077h): it is not watched")
    watchdog, told = _watchdog(profile, lacks, can_guard=can_guard)
    if told:
        changes["watchdog"] = watchdog
        lines += told
    return (profile.model_copy(update=changes) if changes else profile), tuple(lines)


def _watchdog(
    profile: Profile, lacks: Callable[[str | None], bool], *, can_guard: bool
) -> tuple[Watchdog, list[str]]:
    """What watches the drive's link, and a line about what is not as the profile says."""
    watchdog, lines = profile.watchdog, []
    none = {"kind": "none", "parameter": None}
    if lacks(watchdog.parameter):
        guards = watchdog.guard_time is not None and not (
            lacks(watchdog.guard_time) or lacks(watchdog.life_factor)
        )
        at = profile.parameters[watchdog.parameter or ""].address
        if guards and can_guard:
            watchdog = watchdog.model_copy(
                update={"kind": "guarding", "parameter": watchdog.guard_time}
            )
            lines.append(f"the drive has no heartbeat consumer ({at}): it is guarded (100Ch)")
        elif guards:
            watchdog = watchdog.model_copy(update=none)
            lines.append(
                f"the drive has no heartbeat consumer ({at}), and its life guarding (100Ch) needs "
                "remote frames, which this link does not carry: a dead link is not noticed; "
                "another adapter helps"
            )
        else:
            watchdog = watchdog.model_copy(update=none)
            lines.append(
                f"the drive has no watchdog of communication ({at}): it does not notice a dead link"
            )
    if watchdog.kind != "none" and lacks(watchdog.reaction):
        at = profile.parameters[watchdog.reaction or ""].address
        watchdog = watchdog.model_copy(update={"reaction": None, "reaction_raw": None})
        lines.append(
            f"what the drive does when the link is dead cannot be set ({at}): its proof shows it"
        )
    return watchdog, lines
