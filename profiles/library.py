"""Which profiles there are, and which one fits a drive."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from profiles.address import MailboxAddress, ModbusAddress
from profiles.errors import IdentityMismatch, ProfileError, UnknownName
from profiles.files import contents
from profiles.identity import NOBODY, Identity
from profiles.parameter import Protection
from profiles.schema import Profile
from profiles.toml_files import parse_model, parse_tree, read_text, validated

if TYPE_CHECKING:
    from profiles.axis import Axis
    from profiles.draft import Draft
    from profiles.eds import Eds
    from profiles.table_rows import Row

__all__ = [
    "builtin_names",
    "check",
    "digest",
    "draft_from_csv",
    "draft_from_eds",
    "draft_from_stored_eds",
    "draft_from_table",
    "fitting",
    "load_profile",
    "outdated",
    "read_profile",
    "source_text",
]


def outdated(profile: Profile) -> str:
    """Why a profile that lies in a run may be wrong by what is known now; ''."""
    if profile.name not in builtin_names():
        return ""
    now = _builtin(profile.name).version
    if now == profile.version:
        return ""
    return (
        f"this run was measured by profile {profile.name} {profile.version}, and the built-in one "
        f"is {now} by now: its addresses may have been corrected since. 'tworelay identify' "
        "measures by that one"
    )


def builtin_names() -> list[str]:
    """Names of the profiles that come with tworelay."""
    folder = files("profiles") / "builtin"
    return sorted(item.name[:-5] for item in folder.iterdir() if item.name.endswith(".toml"))


def load_profile(name_or_path: str, *, lenient: bool = False) -> Profile:
    """A built-in profile by its name, or any profile by the path of its file; raises ProfileError.

    What `check` calls an error is one. Not so with `lenient`, for stopping, restoring and
    reporting, which must not fail on what an older version took: keys that are not known are passed
    over, too.
    """
    profile = read_profile(name_or_path, lenient=lenient)
    if not _is_path(name_or_path):
        return profile
    errors = [finding.text for finding in check(profile) if finding.severity == "error"]
    if errors and not lenient:
        more = f" (and {len(errors) - 1} more: tworelay profile check)" if errors[1:] else ""
        raise ProfileError(f"{name_or_path}: {errors[0]}{more}")
    return profile


def read_profile(name_or_path: str, *, lenient: bool = False) -> Profile:
    """The same, whatever `check` says of it."""
    if not _is_path(name_or_path):
        return _builtin(name_or_path)
    return _profile_of(read_text(Path(name_or_path)), name_or_path, lenient=lenient)


def source_text(name_or_path: str) -> str:
    """The profile as it is written; one that extends another is written out whole."""
    read_profile(name_or_path)
    text = read_text(Path(name_or_path)) if _is_path(name_or_path) else _builtin_text(name_or_path)
    tree = parse_tree(text, name_or_path)
    if "extends" not in tree:
        return text
    import tomlkit

    return tomlkit.dumps(_extended(tree, name_or_path))


def source_of(axis: Axis, profile: Profile) -> str:
    """The text of the profile that `axis` has, or that was found for its drive."""
    return source_text(axis.profile or profile.name)


def as_written(axis: Axis, profile: Profile) -> Profile:
    """The profile of `axis`, without what the axis file says otherwise."""
    return load_profile(axis.profile or profile.name)


_SHORT = 2  # letters of a word that says nothing
_GONE = ("brake",)  # sections of 0.1.0 that said nothing which is used


def _profile_of(text: str, origin: str, *, lenient: bool = False) -> Profile:
    return validated(_extended(parse_tree(text, origin), origin), Profile, origin, lenient=lenient)


def _extended(tree: dict[str, Any], origin: str) -> dict[str, Any]:
    """A tree on top of the built-in profile that it `extends`, less what is `without`."""
    for section in _GONE:
        tree.pop(section, None)
    base = tree.pop("extends", None)
    without = tree.pop("without", [])
    if base is None:
        if without:
            raise ProfileError(f"{origin}: without: stands beside extends only")
        return tree
    if base not in builtin_names():
        raise ProfileError(f"{origin}: extends '{base}': there are {', '.join(builtin_names())}")
    below = _extended(parse_tree(_builtin_text(base), base), base)
    if not isinstance(without, list) or not all(isinstance(name, str) for name in without):
        raise ProfileError(f"{origin}: without: must be a list of names")
    for name in without:
        section, _, key = name.rpartition(".")  # as modes.position
        places = (below.get(section, {}),) if section else (below, below.get("parameters", {}))
        tables = [table for table in places if isinstance(table, dict) and key in table]
        if not tables:
            raise ProfileError(f"{origin}: without '{name}', which '{base}' does not have")
        for table in tables:
            del table[key]
    law = tree.get("compensation")
    if isinstance(law, dict) and "law" in law:  # it replaces the other one whole
        below.pop("compensation", None)
    return _merged(below, tree)


def _merged(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Tables are merged key by key, anything else is replaced."""
    found = dict(below)
    for key, value in above.items():
        old = found.get(key)
        found[key] = (
            _merged(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
        )
    return found


def digest(profile: Profile) -> str:
    """SHA-256 of what the profile says, independent of how its file is laid out."""
    return hashlib.sha256(profile.model_dump_json(by_alias=True).encode()).hexdigest()


def fitting(identity: Identity, bus: str) -> Profile:
    """The one built-in profile whose identity matches; raises IdentityMismatch for none or several.

    Profiles that ask for no identity fit nothing by themselves: they are named explicitly.
    """
    fits = [
        profile
        for profile in map(_builtin, builtin_names())
        if profile.bus == bus and not profile.identity.empty and profile.identity.accepts(identity)
    ]
    if len(fits) == 1:
        return fits[0]
    if identity == NOBODY:
        raise IdentityMismatch(
            "the drive does not say who it is, so its profile is not known: give --profile (one of "
            f"'tworelay profile list' for {bus}, or your own file)"
        )
    if not fits:
        raise IdentityMismatch(
            f"no built-in profile fits {identity} on {bus}",
            hint="name one with --profile (generic: 'cia402' on CANopen) or bring your own file",
        )
    names = ", ".join(profile.name for profile in fits)
    raise IdentityMismatch(
        f"several profiles fit {identity}: {names}", hint="name one with --profile"
    )


def _is_path(name: str) -> bool:
    return name.endswith(".toml") or "/" in name or "\\" in name


@cache
def _builtin(name: str) -> Profile:
    if name not in builtin_names():
        raise UnknownName("profile", name, builtin_names())
    return _profile_of(_builtin_text(name), f"profile '{name}'")


def _builtin_text(name: str) -> str:
    return (files("profiles") / "builtin" / f"{name}.toml").read_text("utf-8")


@dataclass(frozen=True, slots=True)
class Finding:
    """One remark of `check`: how bad it is, and what it is about."""

    severity: str  # "error" or "warning"
    text: str


def check(profile: Profile) -> list[Finding]:
    """What in a valid profile will nevertheless go wrong at the machine."""
    found: list[Finding] = []
    seen: dict[tuple[int, int], tuple[str, int]] = {}  # cell: who has which bits of it
    for name, parameter in profile.parameters.items():
        address = parameter.address
        if isinstance(address, ModbusAddress):
            cells = [(address.register_ + k, 0) for k in range(address.count)]
            bits = address.bits or 0xFFFF
        elif isinstance(address, MailboxAddress):
            cells, bits = [(-1 - address.pnu, address.sub)], 0xFFFF
        else:
            cells, bits = [(address.index, address.sub)], 0xFFFF
        for cell in cells:
            other, taken = seen.get(cell, (name, 0))
            if taken & bits:
                text = f"[parameters.{name}] overlaps '{other}' at {address}"
                if {name, other} == {"mode_of_operation", "mode_display"}:
                    text += ": leave mode_display out, the mode is read back where it is written"
                found.append(Finding("error", text))
            seen[cell] = (name, taken | bits)
    found += [
        Finding("warning", f"[parameters.{name}] is written by apply but unverified")
        for name in (
            *profile.compensation.written,
            *(profile.loops.terms.values() if profile.loops else ()),
        )
        if profile.parameters[name].trust == "unverified"
    ]
    named = set(profile.compensation.terms.values())
    found += [
        Finding(
            "warning",
            f"[parameters.{name}] has protection 'compensation', and no term of [compensation] "
            "names it",
        )
        for name, parameter in profile.parameters.items()
        if parameter.protection is Protection.COMPENSATION and name not in named
    ]
    if profile.compensation.terms:
        if not profile.compensation.acts_in:
            found.append(Finding("error", "[compensation] acts in no mode"))
        elif set(profile.compensation.acts_in) == {"torque"}:
            found.append(
                Finding(
                    "error", "[compensation] acts in torque mode only, where nothing is positioned"
                )
            )
        if profile.store is None:
            found.append(
                Finding("warning", "[store] is missing: what is written is lost at power-off")
            )
    if not profile.moves:
        found.append(
            Finding(
                "warning", "[modes] has no torque: nothing is moved, only recordings can be used"
            )
        )
        return found
    return found + _of_motion(profile)


def _of_motion(profile: Profile) -> list[Finding]:
    """What will go wrong with a drive that is moved."""
    found: list[Finding] = []
    if not profile.stop:
        found.append(Finding("error", "[stop] is empty: there is no way to stop the drive"))
    if not profile.disable:
        found.append(Finding("error", "[disable] is empty: there is no way to take its energy"))
    if profile.watchdog.kind == "none":
        found.append(
            Finding("warning", "[watchdog] kind is 'none': the drive does not notice a dead link")
        )
    found += [
        Finding("warning", f"[limits] has no {kind} limit in the drive")
        for kind in ("torque", "speed")
        if kind not in profile.limits
    ]
    return found


def draft_from_eds(path: Path) -> Draft:
    """A profile of the drive that an EDS or DCF describes; raises ProfileError."""
    from profiles.eds import read_eds

    return _drafted(read_eds(path), path.name)


def draft_from_stored_eds(data: bytes, origin: str) -> Draft:
    """A draft from the EDS that a drive carries; `origin` names the drive."""
    from profiles.eds import parse_eds

    return _drafted(parse_eds(data, origin), origin)


def _drafted(eds: Eds, origin: str) -> Draft:
    from profiles.draft import from_eds

    draft = from_eds(eds, _builtin_text("cia402"), origin)
    parse_model(draft.text, Profile, f"{origin} makes a profile that is not valid")
    known = [f"the built-in profile '{name}' {why}" for name, why in _built_in_for(eds)]
    return replace(draft, notes=(*known, *draft.notes))


def _built_in_for(eds: Eds) -> Iterator[tuple[str, str]]:
    """Built-in profiles of the drive that a file describes, and why."""
    said = f"{eds.vendor_name} {eds.product_name}".lower()
    who = [
        f"0x{number:08X}" if number else "" for number in (eds.vendor, eds.product, eds.revision)
    ]
    identity = Identity(vendor=who[0], product=who[1], revision=who[2], serial="")
    for profile in map(_builtin, builtin_names()):
        if profile.bus != "canopen":
            continue
        maker, *product = re.findall(r"[a-z0-9-]+", profile.title.split(" on ")[0].lower())
        if not profile.identity.empty and profile.identity.accepts(identity):
            yield profile.name, "is for this drive, by its identity"
        elif maker in said and any(word in said for word in product if len(word) > _SHORT):
            yield profile.name, "may be for this drive, by its name: compare"


def draft_from_csv(path: Path) -> Draft:
    """A profile of the drive whose registers a table lists; raises ProfileError."""
    from profiles.table_rows import LARGEST, read_csv

    try:
        data = contents(path, LARGEST)
    except OSError as error:
        raise ProfileError(f"{path}: cannot be read: {error.strerror or error}") from None
    return draft_from_table(read_csv(data, path.name), path.stem, path.name)


def draft_from_table(rows: list[Row], title: str, origin: str = "answers") -> Draft:
    """A profile of the drive that has these registers; raises ProfileError."""
    from profiles.table import from_table

    draft = from_table(rows, title, origin)
    parse_model(draft.text, Profile, f"{origin} makes a profile that is not valid")
    return draft
