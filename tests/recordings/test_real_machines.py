"""Recordings of real machines, read as a user reads them.

They lie beside the project and are not in it.
"""

from __future__ import annotations

import json
from typing import Any

import pytest

from tests.command import ROOT
from tests.conftest import Tworelay

RECORDINGS = ROOT.parent / "shared" / "data" / "recordings"
pytestmark = pytest.mark.skipif(
    not RECORDINGS.is_dir(), reason="the recordings are not beside the project"
)


def analyzed(tworelay: Tworelay, *arguments: str) -> dict[str, Any]:
    done = tworelay("analyze", *arguments, "--json", "-")
    assert done.returncode == 0, done.stderr
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def test_the_emps_benchmark(tworelay: Tworelay) -> None:
    """Janot, Gautier, Brunot 2019.

    Fc 20.3935 N, M 95.1089 kg, Fv 203.5034 N.s/m, offset -3.1648 N.
    """
    result = analyzed(
        tworelay, str(RECORDINGS / "emps" / "DATA_EMPS.mat"),
        "--time", "t:s", "--position", "qm:m", "--torque", "vir:gtau N",
    )  # fmt: skip
    friction = result["friction"]
    assert friction["coulomb"]["value"] == pytest.approx(20.3935, rel=0.04)
    assert friction["inertia"]["value"] == pytest.approx(95.1089, rel=0.02)
    assert friction["viscous"]["value"] == pytest.approx(203.5034, rel=0.05)
    assert friction["offset"]["value"] == pytest.approx(-3.1648, abs=0.2)
    for name, published in (("coulomb", 20.3935), ("inertia", 95.1089), ("viscous", 203.5034)):
        assert friction[name]["low"] <= published <= friction[name]["high"]
    assert friction["inertia"]["unit"] == "kg"


@pytest.mark.parametrize(
    ("drive", "coulomb", "has_stribeck"),
    [("driveNo1", 2.59e-3, True), ("driveNo2", 4.76e-3, False)],
)
def test_the_epos_axes_at_constant_speeds(
    tworelay: Tworelay, drive: str, coulomb: float, has_stribeck: bool
) -> None:
    """Mablekos-Alexiou et al. 2021; a curve is judged by the speeds that were left out."""
    folder = RECORDINGS / "epos_screw" / "experiments" / drive / "steady_state" / "0.096kg"
    result = analyzed(
        tworelay, "--steady", *(str(path) for path in sorted(folder.glob("*.csv"))),
        "--velocity", "Velocity actual value averaged:rpm",
        "--torque", "Torque actual value averaged:9.84e-5 Nm",
    )  # fmt: skip
    steady = result["methods"]["steady"]
    assert steady["held_out"] <= 0.03
    assert (steady["stribeck_speed"] is not None) is has_stribeck
    # other fits of the same files differ by 12 % (tests judge the curve, not the number)
    assert result["friction"]["coulomb"]["value"] == pytest.approx(coulomb, rel=0.12)
