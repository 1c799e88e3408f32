"""What a profile says, clause by clause, against what its twin has heard.

A clause that was not heard is not performed: its section, what it says, and what came instead.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import NamedTuple

from commissioning.performance.acts import Account
from commissioning.performance.trying import FRACTION
from commissioning.session.verify import provable
from drivers.link import agreed, modbus_wire, parse
from profiles.errors import IdentityMismatch, TwoRelayError
from profiles.identity import Identity
from profiles.law import Amount
from profiles.parameter import Access, Protection
from profiles.procedures import Condition, Mode, ModeCode, Step
from profiles.schema import Profile

__all__ = ["Unheard", "unheard"]

_ROUNDING = 0.02, 0.05  # share of a time, and s, within which it was kept
_EXPECTED = "guard ", "requires ", "link.", "patience.", "compensation at work"  # to be refused
_SETTLED = frozenset({"position_target"})  # put back as where the axis is
_FUNCTIONS = {"fc23": {23}, "fc16+3": {16}, "fc6+3": {6}}
_HEARTBEAT, _NODE_AT = 0x700, 16
_SERIAL = "modbus-rtu:LINE"


class Unheard(NamedTuple):
    """A clause that is not performed."""

    section: str
    text: str

    def __str__(self) -> str:
        return f"[{self.section}] {self.text}"


Found = Iterator[Unheard]


def unheard(heard: Account) -> list[Unheard]:
    """Every clause of the profile that was not performed; none: all of it is."""
    found = [
        Unheard(_section(act, error, heard.profile), f"cannot be done: {error}")
        for act, error in heard.trouble.items()
        if not act.startswith(_EXPECTED)
    ]
    if found:  # what follows from it is not said as well
        return found
    for clauses in (
        _identity, _link, _parameters, _cycle, _modes, _power, _stopping, _conditions, _limits,
        _watchdog, _patience, _memory, _compensation, _loops,
    ):  # fmt: skip
        found += clauses(heard.profile, heard)
    return found


_BY_CODE = {
    "preflight.cycle": "link", "watchdog": "watchdog", "mode": "modes.torque",
    "set-point": "modes.torque", "scale": "parameters", "power": "power", "fault": "power",
    "preflight.requires": "requires", "preflight.enabling-value": "power",
}  # fmt: skip
_BY_ACT = {
    "torque": "modes.torque", "position": "modes.position", "reset": "power",
    "apply": "compensation", "undo": "compensation", "gains": "loops", "deaf stop": "stop",
    "prepare": "modes.torque", "back": "modes.torque", "open": "cycle", "look": "parameters",
}  # fmt: skip


def _section(act: str, error: TwoRelayError, profile: Profile) -> str:
    """Where in the file to look for what an act does."""
    if act.startswith("read "):
        return f"parameters.{act[5:]}"
    act, _, variant = act.partition(" of ")
    by_code = _BY_CODE.get(error.code) or _BY_CODE.get(error.code.split(".")[0])
    there = by_code or _BY_ACT.get(act, act)
    return (variant or there).split(" ")[0] if by_code is None else there


# -- sections of a profile, in its order ----------------------------------------------------------


def _identity(profile: Profile, heard: Account) -> Found:
    said = profile.identity
    if profile.bus == "modbus" and (43 in heard.functions["open"]) is not said.asked:
        instead = "is asked" if not said.asked else "is not asked"
        yield Unheard("identity", f"asked = {str(said.asked).lower()}: function 43 {instead}")
    if profile.bus == "canopen" and "1018h:01" not in heard.reads("open"):
        yield Unheard("identity", "1018h is not asked")
    right = Identity(
        vendor=said.vendor or "", product=said.product or "", revision=(*said.revisions, "")[0],
        serial="",
    )  # fmt: skip
    for key, field in (("vendor", "vendor"), ("product", "product"), ("revisions", "revision")):
        if getattr(said, key):
            other = right.model_copy(update={field: "another"})
            try:
                agreed(other, profile.bus, profile)
            except IdentityMismatch:
                continue
            yield Unheard("identity", f"{key} is not looked at")


def _link(profile: Profile, heard: Account) -> Found:
    link = profile.link
    for name in link.swapped_for:
        if name not in heard.reads("word order"):
            yield Unheard("link", f"swapped_for: '{name}' is not read")
    if profile.bus == "modbus":
        line = modbus_wire(parse(_SERIAL), profile)
        for key, kept in (
            ("baudrate", "baudrate"), ("parity", "parity"), ("stopbits", "stopbits"),
            ("silence", "gap"),
        ):  # fmt: skip
            value = getattr(link, key)
            if value is not None and getattr(line, kept) != value:
                yield Unheard("link", f"{key} {value}: a line is opened with {getattr(line, kept)}")
    if profile.moves:
        times = [s.time for s in heard.said["torque"] if s.name == "position_actual"]
        steps = {round(b - a, 9) for a, b in pairwise(times)}
        if not any(abs(step - link.cycle) < 1e-6 for step in steps):
            yield Unheard("link", f"cycle {link.cycle:g} s: nothing is exchanged so")


def _parameters(profile: Profile, heard: Account) -> Found:
    every = [one for said in heard.said.values() for one in said]
    read = {one.name for one in every if one.act == "read"}
    written = {one.name for one in every if one.act == "write"}
    for name, parameter in profile.parameters.items():
        section = f"parameters.{name}"
        if parameter.access is Access.WRITE_ONLY:
            if name in read:
                yield Unheard(section, "access 'wo', and it is read")
        elif name not in heard.reads(f"read {name}"):
            yield Unheard(section, f"{parameter.address} is not read")
        if parameter.protection is Protection.READ and name in written:
            yield Unheard(section, "protection 'read', and it is written")
        for act, said in heard.said.items():
            if act == f"guard {name}" and any(one.act == "write" for one in said):
                yield Unheard(section, "a value that must not be written is written")
    for name, before in heard.delivered.items() if profile.moves else ():
        left = heard.left.get(name)
        if left != before and name not in _SETTLED:
            yield Unheard(f"parameters.{name}", f"{before:g} before a job, and {left} after it")


def _cycle(profile: Profile, heard: Account) -> Found:
    if not profile.moves:
        return
    cycle = profile.cycle
    for key, names, act in (("out", cycle.out, "write"), ("in", cycle.in_, "read")):
        said = [s.name for s in heard.said["torque"] if s.act == act]
        # registers are exchanged in the order of their addresses
        if not _together(list(names), said, in_order=profile.bus == "canopen"):
            yield Unheard("cycle", f"{key} = {', '.join(names)}: not exchanged in one go")
    if profile.bus == "modbus":
        used = heard.functions["torque"]
        if not _FUNCTIONS[cycle.function] <= used or (23 in used) != (cycle.function == "fc23"):
            there = ", ".join(map(str, sorted(used)))
            yield Unheard("cycle", f"function {cycle.function}: functions {there} are used")
        return
    told = {one.name for act in ("prepare", "torque") for one in heard.said[act]}
    for key, first, number in (("rpdo", 0x1400, cycle.rpdo), ("tpdo", 0x1800, cycle.tpdo)):
        at = f"{first + number - 1:04X}h:01"
        if at not in told:
            yield Unheard("cycle", f"{key} {number}: {at} is not set")


def _modes(profile: Profile, heard: Account) -> Found:
    for mode, codes in profile.modes.items():
        for number, code in enumerate(codes, 1):
            yield from _mode(mode, number, code, profile, heard)


def _mode(mode: Mode, number: int, code: ModeCode, profile: Profile, heard: Account) -> Found:
    section = f"modes.{mode}"
    of = f" of modes.{mode} {number}" if number > 1 else ""
    said = [*heard.writes("prepare" + of), *heard.writes(f"{mode}{of}")]
    for step in code.before:
        if step.write is not None and not _was_written(step, said, heard):
            yield Unheard(section, f"before: {_words(step)}: it is not written")
    if code.code is not None:
        if ("mode_of_operation", code.code) not in said:
            yield Unheard(section, f"code {code.code}: it is not told to the drive")
        both = "mode_display" not in profile.parameters
        if ("mode_of_operation" if both else "mode_display") not in heard.reads(f"{mode}{of}"):
            yield Unheard(section, f"code {code.code}: whether the drive has taken it is not read")
    points = [raw for name, raw in heard.writes(f"{mode}{of}") if name == code.set_point]
    if len(set(points)) < 3:  # to one side, to the other, and back
        yield Unheard(section, f"set_point '{code.set_point}': it is not commanded")
    chosen = heard.told.get(f"code {mode} {number}", "supported_modes" not in profile.parameters)
    if code.supported_bit is not None and chosen is not True:
        yield Unheard(section, f"supported_bit {code.supported_bit} does not choose it")


def _power(profile: Profile, heard: Account) -> Found:
    power = profile.power
    if not profile.moves:
        return
    if heard.said.get("reset") is not None and (
        heard.told.get("in fault") is not True or heard.told.get("after reset") is not False
    ):
        yield Unheard("power", "a fault is not recognised, or not reset")
    if power is None:
        return
    yield from _steps("power", "enable", power.enable, "torque", heard)
    if power.fault is not None:
        yield from _steps("power", "reset", power.reset, "reset", heard)
    for sign in ("enabled", "stopping", "fault"):
        condition: Condition | None = getattr(power, sign)
        if condition is not None and heard.told.get(f"says {sign}") is not True:
            yield Unheard("power", f"{sign}: '{condition.parameter}' {condition}: not seen so")


def _stopping(profile: Profile, heard: Account) -> Found:
    if not profile.moves:
        return
    yield from _steps("stop", "step", profile.stop, "stop", heard)
    yield from _steps("disable", "step", profile.disable, "stop", heard)
    writes = heard.writes("stop")
    first = [_write(step) for step in (*profile.stop, *profile.disable) if step.write is not None]
    if not _in_order(first, writes):
        yield Unheard("stop", "is not written before [disable]")
    took = heard.told.get("stop time")
    waits = sum(step.within for step in profile.stop if step.until is not None)
    if isinstance(took, float) and not waits and not _kept(took, profile.stop_time):
        yield Unheard("stop_time", f"{profile.stop_time:g} s: a drive that does not stop is given "
                      f"{took:.3g} s")  # fmt: skip


def _conditions(profile: Profile, heard: Account) -> Found:
    for number, condition in enumerate(profile.requires):
        error = heard.trouble.get(f"requires {number}")
        looked = not profile.moves or condition.parameter in heard.reads("look")
        if not looked or error is None or error.code != "preflight.requires":
            yield Unheard("requires", f"'{condition.parameter}' {condition}: nobody looks")
    lock = profile.exclusive
    if lock is not None:
        for act in ("prepare", "apply") if profile.moves else ("apply",):
            if _write(lock) not in heard.writes(act)[:1]:
                yield Unheard("exclusive", f"{_words(lock)}: it is not written first")


def _limits(profile: Profile, heard: Account) -> Found:
    if not profile.moves:
        return
    written = {name for name, _ in heard.writes("prepare")}
    for kind, name in profile.limits.items():
        if kind == "current":
            if name not in heard.reads("look"):
                yield Unheard("limits", f"{kind}: '{name}' is not looked at")
        elif name not in written:
            yield Unheard("limits", f"{kind}: '{name}' is not set")


def _watchdog(profile: Profile, heard: Account) -> Found:
    watchdog = profile.watchdog
    if watchdog.kind == "none" or not profile.moves:
        return
    name, written = watchdog.parameter, dict(heard.writes("prepare"))
    if name is not None:
        raw, parameter = int(written.get(name, 0)), profile.parameters[name]
        time, node = raw, watchdog.node
        if watchdog.kind == "heartbeat":
            time, node = raw & (1 << _NODE_AT) - 1, raw >> _NODE_AT
        kept = abs(time * parameter.scale - watchdog.timeout) <= abs(parameter.scale)
        if watchdog.kind != "guarding" and not kept:
            yield Unheard("watchdog", f"timeout {watchdog.timeout:g} s: '{name}' is set to {raw}")
        if node != watchdog.node:
            yield Unheard("watchdog", f"node {watchdog.node}: '{name}' is set to node {node}")
    if watchdog.reaction is not None and (
        (watchdog.reaction, watchdog.reaction_raw) not in heard.writes("prepare")
        and heard.delivered.get(watchdog.reaction) != watchdog.reaction_raw
    ):
        yield Unheard("watchdog", f"reaction: '{watchdog.reaction}' is not set")
    if watchdog.kind == "heartbeat" and _HEARTBEAT + watchdog.node not in heard.identifiers:
        yield Unheard("watchdog", f"kind heartbeat: node {watchdog.node} sends none")
    guarded = {name for name, _ in heard.writes("prepare of guarding")}
    for key in ("guard_time", "life_factor") if watchdog.guard_time is not None else ():
        if getattr(watchdog, key) not in guarded:
            yield Unheard("watchdog", f"{key}: '{getattr(watchdog, key)}' is not set")


def _patience(profile: Profile, heard: Account) -> Found:
    for section, said in (("patience", profile.patience), ("link", profile.link)):
        for key in said.model_fields_set:
            took = heard.told.get(f"{section}.{key}")
            if isinstance(took, float) and not _kept(took, getattr(said, key)):
                yield Unheard(section, f"{key} {getattr(said, key):g} s: it is borne with for "
                              f"{took:.3g} s")  # fmt: skip


def _memory(profile: Profile, heard: Account) -> Found:
    if profile.store is None:
        return
    yield from _steps("store", "step", profile.store.steps, "store", heard)
    if heard.told.get("worn") is not False:
        yield Unheard("store", f"endurance {profile.store.endurance}: nobody counts")


def _compensation(profile: Profile, heard: Account) -> Found:
    law = profile.compensation
    written = dict(heard.writes("apply"))
    amount = Amount(FRACTION * 1.0, 1.0, FRACTION * 1.0, "", 1.0)
    for name, wanted in law.values(amount).items():
        if not written.get(name):
            yield Unheard("compensation", f"'{name}' is not written")
        elif name == law.negative and (
            written[name] * wanted.value * profile.parameters[name].scale < 0
        ):
            yield Unheard("compensation", f"negative_sign: '{name}' is written as {written[name]}")
    for name in law.terms.values():
        if name not in heard.reads("apply"):
            yield Unheard("compensation", f"'{name}' is not read before it is written")
    if not profile.moves:
        return
    refused = heard.trouble.get("compensation at work")
    looks = refused is not None and refused.code == "preflight.compensation"
    if law.terms and looks is not (Mode.TORQUE in law.acts_in):
        yield Unheard("compensation", "acts_in: what acts in torque mode is not looked at")
    if law.acts_stored and law.terms and _code(profile) not in (
        "verify.acts-stored", "verify.no-position-mode"
    ):  # fmt: skip
        yield Unheard("compensation", "acts_stored: it is tried step by step all the same")
    if law.host is not None and heard.told.get("host") != 0:
        yield Unheard("compensation", f"host: '{law.host}' is left on top of every command")


def _code(profile: Profile) -> str:
    """Why its compensation cannot be proved; ''."""
    try:
        provable(profile)
    except TwoRelayError as error:
        return error.code
    return ""


def _loops(profile: Profile, heard: Account) -> Found:
    told = heard.reads("conditions")
    for section, names in (
        ("own_estimates", profile.own_estimates.values()),
        ("conditions", profile.conditions.values()),
    ):
        for name in names:
            if name not in told:
                yield Unheard(section, f"'{name}' is not read")
    loops = profile.loops
    if loops is None:
        return
    if loops.lag is not None and profile.moves and loops.lag not in heard.reads("look"):
        yield Unheard("loops", f"lag: '{loops.lag}' is not read")
    written = {name for name, _ in heard.writes("gains")}
    for term, name in loops.terms.items():
        if name not in written:
            yield Unheard("loops", f"{term}: '{name}' is not written")


# -- steps ----------------------------------------------------------------------------------------


def _steps(section: str, what: str, steps: Iterable[Step], act: str, heard: Account) -> Found:
    """Each step of a procedure: written, or looked at; and all writes in their order."""
    there, every = heard.writes(act), tuple(steps)
    writes = [_write(step) for step in every if step.write is not None]
    for number, step in enumerate(every, 1):
        if step.write is not None and _write(step) not in there:
            yield Unheard(section, f"{what} {number}: {_words(step)}: it is not written")
            return
        if step.until is not None and step.until not in heard.reads(act):
            yield Unheard(section, f"{what} {number}: {_words(step)}: nobody looks")
    if not _in_order(writes, there):
        yield Unheard(section, f"{what}s are not written in their order")


def _was_written(step: Step, said: list[tuple[str, float]], heard: Account) -> bool:
    """Whether a step was written, or had no need to be."""
    return _write(step) in said or heard.delivered.get(step.write or "") == step.raw


def _write(step: Step) -> tuple[str, float]:
    return step.write or "", float(step.raw or 0)


def _words(step: Step) -> str:
    if step.write is not None:
        return f"write {step.raw} to '{step.write}'"
    return f"until '{step.until}' reads {step.equals}"


def _in_order(wanted: list[tuple[str, float]], there: list[tuple[str, float]]) -> bool:
    """Whether all come, one after the other, whatever lies between."""
    rest = iter(there)
    return all(one in rest for one in wanted)


def _together(wanted: list[str], there: list[str], *, in_order: bool) -> bool:
    """Whether they come at once, nothing between."""
    size = len(wanted)
    if not in_order:
        wanted = sorted(wanted)
    windows = (there[at : at + size] for at in range(len(there) - size + 1))
    return any((window if in_order else sorted(window)) == wanted for window in windows)


def _kept(took: float, time: float) -> bool:
    share, least = _ROUNDING
    return abs(took - time) <= share * time + least
