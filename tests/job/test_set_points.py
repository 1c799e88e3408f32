"""A profile whose scales are wrong: refused in one line before anything moves."""

from __future__ import annotations

import re
from pathlib import Path

from profiles.library import source_text
from tests.conftest import Tworelay


def test_a_torque_limit_that_the_register_cannot_hold_is_refused(
    tworelay: Tworelay, tmp_path: Path
) -> None:
    """The torque of a real drive in 0.001 of the rated one, taken for 0.000 01 of it."""
    text = source_text("virtual-modbus")
    head, target = text.split("[parameters.torque_target]")
    wrong = re.sub(r"scale = \S+", "scale = 0.00001", target, count=1)
    profile = tmp_path / "wrong.toml"
    profile.write_text(f"{head}[parameters.torque_target]{wrong}")
    axis = tmp_path / "axis.toml"
    axis.write_text(f'link = "virtual://bench"\nprofile = "{profile}"\ntravel = 3.0\n')
    done = tworelay("identify", str(axis), "--yes")
    assert done.returncode == 3
    assert re.search(
        r"-?\d{5,} of 'torque_target' \(register 0100h\), which takes -32768…32767", done.stderr
    )
    assert len(done.stderr.strip().splitlines()) == 1
