"""What a profile's procedures say is performed.

Braking to standstill, and each mode's preparations.
"""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest

from commissioning.envelope import Envelope
from commissioning.errors import EnvelopeTripped
from commissioning.experiments.plan import Plan
from commissioning.interruption import Interruption
from commissioning.journal import Journal
from commissioning.runner import Recorder, run
from drivers.home import home
from drivers.link import axis_of, open_drive
from drivers.profiled import ProfiledDrive
from profiles.axis import Axis
from profiles.library import builtin_names, load_profile
from profiles.procedures import Mode
from tests.command import ROOT
from tests.conftest import Serve, Tworelay

TWO_KEY = str(ROOT / "tests/faults/two_key.toml")
PROCEDURES = [
    loaded.name
    for loaded in map(load_profile, builtin_names())
    if loaded.power is not None and loaded.moves and loaded.stop != loaded.disable
]
INERTIA, COULOMB, PEAK = 0.02, 0.1, 3.0  # kg.m2, N.m, N.m


def served(serve: Serve, profile: str, *options: str) -> str:
    """A twin that steps."""
    twin = ("--profile", profile, "--modbus-tcp", "127.0.0.1:0", "--clock", "step")
    return serve("bench", *twin, *options)[0]


@pytest.mark.parametrize("profile", [*PROCEDURES, TWO_KEY])
def test_a_stop_brakes_to_standstill_before_the_energy_goes(serve: Serve, profile: str) -> None:
    """With the drive's peak torque from v: v² J / 2 (T + f).

    On friction alone it would be v² J / 2 f.
    """
    link = served(serve, profile, "--set", f"inertia={INERTIA}")
    drive = open_drive(Axis(link=link, profile=profile, rated_torque=1.0, encoder=131072))
    for name, raw in drive.preparation.settings(Mode.TORQUE).items():
        drive.write(name, raw)
    drive.enable(Mode.TORQUE)
    samples = [drive.exchange(0.6) for _ in range(60)]
    v = (samples[-1].position - samples[-2].position) / (samples[-1].time - samples[-2].time)
    assert v > 3.0
    assert drive.stop().deenergised
    began, ended = samples[-1].position, drive.read("position_actual").si
    drive.wait(0.05)
    assert drive.read("position_actual").si == pytest.approx(ended, abs=1e-4)
    coasting = v**2 * INERTIA / (2 * COULOMB)
    braking = v**2 * INERTIA / (2 * (PEAK + COULOMB))
    late = 4 * drive.cycle * (v + 0.5 / INERTIA * 4 * drive.cycle)
    assert ended - began < braking + late
    assert braking + late < 0.5 * coasting
    drive.close()


def test_position_targets_go_to_a_drive_in_position_mode(
    serve: Serve, tworelay: Tworelay, monkeypatch: pytest.MonkeyPatch
) -> None:
    """[[modes.position]] before is performed, [[modes.torque]] before again,
    and all is left as found."""
    link = served(serve, TWO_KEY)
    asked = ("--profile", TWO_KEY, "--travel", "3", "--yes")
    modes: list[tuple[Mode, int]] = []
    enable = ProfiledDrive.enable

    def watched(drive: ProfiledDrive, mode: Mode, rest: float = 0.0) -> None:
        modes.append((mode, drive.read("control_mode").raw))
        enable(drive, mode, rest)

    monkeypatch.setattr(ProfiledDrive, "enable", watched)
    done = tworelay("identify", link, *asked, "--method", "modulating")
    assert done.returncode == 0, done.stderr
    assert set(modes) == {(Mode.TORQUE, 3)}
    modes.clear()
    assert tworelay("apply", "last", "--yes").returncode == 0
    done = tworelay("verify", "last", "--yes")
    assert done.returncode == 0, done.stderr
    assert set(modes) == {(Mode.TORQUE, 3), (Mode.POSITION, 1)}
    with Journal(home()) as journal:
        run_id = journal.open_runs()[0]
        kinds = {i.kind for i in journal.intents(run_id, open_only=True)}
    assert kinds == {"compensation"}
    drive = open_drive(Axis(link=link, profile=TWO_KEY))
    left = {
        n: drive.read(n).raw for n in ("control_mode", "key_1", "key_2", "halt", "torque_target")
    }
    rest = drive.read("position_target").raw - drive.read("position_actual").raw
    drive.close()
    assert abs(rest) < 2, "a position target that is left is where the axis is"
    assert left == dict.fromkeys(left, 0)


def test_a_killed_job_leaves_the_keys_in_the_journal(serve: Serve, tworelay: Tworelay) -> None:
    """What enabling writes is remembered before it is written."""
    link = served(serve, TWO_KEY)
    done = tworelay(
        "identify", link, "--profile", TWO_KEY, "--travel", "3", "--yes",
        "--json", "-", "--method", "modulating",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    with Journal(home()) as journal:
        found = [
            (i.old, i.new, i.state)
            for i in journal.intents(json.loads(done.stdout)["run"])
            if i.parameter == "key_1"
        ]
    assert found == [(0, 85, "restored")]


# -- positions are checked by the host ------------------------------------------------------------


@pytest.fixture
def bench() -> Iterator[ProfiledDrive]:
    opened = open_drive(axis_of("virtual://bench"))
    yield opened
    opened.close()


@pytest.mark.parametrize(
    ("target", "message"), [(1.0, "beyond ±0.5 rad"), (0.2, "a step of")], ids=["travel", "step"]
)
def test_a_position_that_is_too_far_is_not_sent(
    bench: ProfiledDrive, target: float, message: str
) -> None:
    def plan() -> Plan[None]:
        yield 0.001
        yield target

    room = Envelope(0.0, 0.5, 10.0, 1.0, 60.0, cycle=bench.cycle, resolution=1e-4)
    with pytest.raises(EnvelopeTripped, match=message):
        run(plan(), bench, room, Recorder(), Interruption(), mode=Mode.POSITION)
    assert abs(bench.read("position_target").si) < 0.01
    assert not bench.state().is_energised
