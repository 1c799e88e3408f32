"""What becomes of a job with each habit of a real drive: done, or refused by name.

The verdicts are those of the issue that the habits were collected for, and not of the code under
test.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from profiles.library import source_text
from tests.serving import WIRES, serve

__all__ = ["CASES", "MODBUS", "Case", "Run", "bus_of", "played"]

_TRUE = {
    "coulomb": (0.1, 0.03),
    "inertia": (1e-3, 0.03),
}  # of the axis `bench`: value, and how near


class Done(Protocol):
    """A command that has ended."""

    returncode: int
    stdout: str
    stderr: str


class Run(Protocol):
    """Runs `tworelay` with these arguments."""

    def __call__(self, *arguments: str) -> Done:
        """Wait for its end."""


@dataclass(frozen=True)
class Case:
    """A drive with habits.

    Attributes
    ----------
    habits : NAME[=VALUE], several compose
    refused : exit code, and words that must be on standard error; None: the job is done, with the
        numbers of a drive without habits
    says : words that must be on standard output of a job that is done
    options : of identify, more
    keys : of the axis file, more
    job : `identify`, or `apply` after it, where the habit shows only there
    edits : of its profile, old text and new
    on : of another link than most, what is refused there
    """

    habits: tuple[str, ...]
    refused: tuple[int, str] | None = None
    says: str = ""
    options: tuple[str, ...] = ()
    keys: dict[str, float] = field(default_factory=dict)
    job: str = "identify"
    edits: dict[str, str] = field(default_factory=dict)
    on: dict[str, tuple[int, str]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """For people."""
        edits = (text.replace(" ", "").replace("\n", " ") for text in self.edits.values())
        return " ".join((*self.habits, *self.options, *self.keys, *edits))


def survives(
    *habits: str,
    says: str = "",
    job: str = "identify",
    options: tuple[str, ...] = (),
    on: dict[str, tuple[int, str]] | None = None,
) -> Case:
    """A case in which the job is done."""
    return Case(habits, says=says, job=job, options=options, on=on or {})


# on a serial line another unit's answer is another drive's
_ON_LINES = dict.fromkeys(("modbus-rtu", "modbus-rtu-tcp"), (4, "answers for unit 1"))
_NOT_ASKED = {'vendor = "tworelay"\nproduct = "virtual drive"': "asked = false"}
_FAULT = {"reaction_raw = 3": "reaction_raw = 1"}  # a dead link is a fault, which is reset
_STORED = "stored in the drive's non-volatile memory"
# on any bus
VALUES = [
    survives("slow-reset"),
    Case(("slow-reset",), edits=_FAULT),
    Case(("slow-reset=1.5",), edits=_FAULT),
    survives("slow-mode"),
    survives("slow-enable"),
    survives("same-mode"),
    survives("halt"),
    survives("wrap"),
    survives("unsigned-torque"),
    survives("limit-bit"),
    survives("zero-limit", options=("--max-torque", "0.9")),
    Case(("zero-limit",), (3, "give --max-torque")),
    survives("quick-stop-stays"),
]
CANOPEN = [
    *(survives(habit) for habit in ("feed", "gear", "old-factor", "modulo", "polarity")),
    Case(("delivered",), (3, "ncoder")),
    survives("lacks=6502h"),
    survives("lacks=1018h+6087h+605Ah+603Fh"),
    survives("lacks=6077h", says="does not tell its torque"),
    survives("lacks=6072h", says="no torque limit"),
    survives("lacks=6080h", says="no speed limit", options=("--max-speed", "100")),
    Case(("lacks=6076h",), (3, "give rated_torque")),
    Case(("lacks=6076h",), keys={"rated_torque": 1.0}),
    Case(("lacks=608Fh",), (3, "ncoder")),
    Case(("lacks=608Fh",), keys={"encoder": 131072.0}),
    Case(("lacks=1016h",), (3, "--without-watchdog")),
    survives("lacks=1016h", options=("--without-watchdog",)),
    survives("lacks=1017h"),
    survives("wide"),
    survives("wide=6072h+60B2h+6007h+605Ah"),
    Case(("wide=6071h",), (2, "6071h:4")),
    Case(("sub1",), (4, "sub-index 1")),
    survives("one-limit"),
    survives("low-current"),
    Case(("low-current",), (3, "6073h"), options=("--max-torque", "0.9")),
    survives("needs-period"),
    survives("short-sdo"),
    survives("unsized"),
    survives("segmented"),
    survives("slow-answer=0.005"),
    survives("busy"),
    survives("slow-save", job="apply", says=_STORED),
    survives("silent-save", job="apply", says=_STORED),
    survives("busy-save", job="apply", says=_STORED),
    survives("slow-boot"),
    survives("lenient"),
    survives("refuses-start"),
    survives("operational"),
    # the socketcand protocol has no remote frames
    Case(("guarding",), on={"socketcand": (3, "--without-watchdog")}),
    survives("guarding", options=("--without-watchdog",)),
    survives("mute-reset"),
    Case(("mute-reset", "refuses-start"), edits=_FAULT),
    survives("warnings"),
    survives("chatty"),
    survives("fixed-pdo"),
    survives("locked-pdo"),
    survives("needs-torque"),
    survives("own-ids"),
    survives("lost-tpdo"),
    survives("short-sdo", "slow-reset", "slow-mode=0.5", "lacks=6502h"),
    survives("feed", "wrap", "polarity", "busy"),
    survives("fixed-pdo", "own-ids", "refuses-start", "needs-period"),
]
MODBUS = [
    survives("slow-answer=0.005"),
    survives("busy"),
    survives("slow-save", job="apply", says=_STORED),
    survives("silent-save", job="apply", says=_STORED),
    survives("busy-save", job="apply", says=_STORED),
    survives("slow-boot"),
    Case(("mute43",), (3, "does not say who it is")),
    Case(("mute43",), edits=_NOT_ASKED),
    survives("no-target"),
    survives("other-unit", on=_ON_LINES),
    survives("other-unit=255", on=_ON_LINES),
    Case(("other-unit=7",), (4, "unit 7 answers for unit 1")),
    Case(("echo",), on={"modbus-tcp": (4, "")}),
    Case(("echo", "noise=7", "fragments"), on={"modbus-tcp": (4, "")}),
    Case(("echo", "slow-answer=0.005"), on={"modbus-tcp": (4, "")}),
    survives("acknowledge"),
    Case(
        ("duplicate",),
        on=dict.fromkeys(("modbus-rtu", "modbus-rtu-tcp"), (4, "do answers come twice")),
    ),
    survives("fragments"),
    survives("noise"),
    survives("lost-answer=200"),
    survives("irregular=0.005"),
    Case(("low-first",), (3, "'encoder_revolutions' (register 0304h")),
    Case(("off-by-one",), (3, "does not tell its rated torque (register 0300h)")),
    survives("busy", "wrap", "slow-reset", "fragments"),
    Case(("slow-boot", "mute43", "lost-answer=200"), edits=_NOT_ASKED),
]
CASES = {
    "canopen": [*VALUES, *CANOPEN],
    "modbus": [*VALUES, *MODBUS],
    "virtual": [case for case in VALUES if not case.edits],
}
_PROFILES = {"canopen": ("cia402", "virtual-canopen"), "modbus": ("virtual-modbus",) * 2}


def bus_of(wire: str) -> str:
    """Which bus a way to connect belongs to."""
    return {"socketcand": "canopen", "slcan": "canopen", "virtual": "virtual"}.get(wire, "modbus")


def played(case: Case, wire: str, run: Run, folder: Path) -> str:
    """'survived' or 'refused by name' where the case wants it so; else what happened instead."""
    if wire == "virtual":
        link = f"virtual://bench?habit={','.join(case.habits)}"
        return _outcome(case, wire, link, "virtual-modbus", run, folder)
    generic, own = _PROFILES[bus_of(wire)]
    profile = own if case.job == "apply" else generic
    twin = ("--profile", profile) if profile == "cia402" else ()
    habits = [word for habit in case.habits for word in ("--habit", habit)]
    with serve("bench", *WIRES[wire], *twin, "--clock", "step", *habits) as links:
        return _outcome(case, wire, links[0], profile, run, folder)


def _outcome(case: Case, wire: str, link: str, profile: str, run: Run, folder: Path) -> str:
    path, result = folder / "press.toml", folder / "result.json"
    if case.edits:
        text = source_text(profile).replace(f'"{profile}"', '"edited"', 1)
        for old, new in case.edits.items():
            assert old in text
            text = text.replace(old, new)
        (folder / "edited.toml").write_text(text)
        profile = str(folder / "edited.toml")
    lines = [f'link = "{link}"', f'profile = "{profile}"', "travel = 20.0"]
    lines += [f"{key} = {value}" for key, value in case.keys.items()]
    path.write_text("\n".join(lines) + "\n")
    done = run(
        "identify", str(path), "--cycle", "0.008", "--yes", *case.options, "--json", str(result)
    )
    if case.job == "apply" and done.returncode == 0:
        done = run("apply", "last", "--yes")
    happened = f"exit {done.returncode}: {' '.join(done.stderr.split())[-300:]}"
    refused = case.on.get(wire, case.refused)
    if refused is not None:
        code, words = refused
        as_wanted = done.returncode == code and words in done.stderr
        return "refused by name" if as_wanted else happened
    if done.returncode != 0 or case.says not in done.stdout:
        return happened
    if case.job == "identify":
        friction = json.loads(result.read_text())["friction"]
        for name, (true, near) in _TRUE.items():
            value = friction[name]["value"]
            if abs(value / true - 1) > near:
                return f"{name} {value:.4g} instead of {true:g}"
    return "survived"
