"""Device configuration files: what another reader finds in them."""

from __future__ import annotations

from pathlib import Path

import canopen

from profiles.dcf import dcf
from profiles.eds import parse_eds
from profiles.library import load_profile


def test_another_reader_finds_the_values(tmp_path: Path) -> None:
    profile = load_profile("virtual-canopen")
    values = {
        "torque_offset": -3, "coulomb_positive": 85, "coulomb_negative": 86, "velocity_gain": 70000,
    }  # fmt: skip
    path = tmp_path / "changes.dcf"
    path.write_text(dcf(profile, values, 5), "utf-8")
    found = canopen.import_od(str(path))
    assert found.node_id == 5
    # 2010h:1 i16, :2 and :3 u16, 2011h:1 u32 (docs/virtual-drive.md); two's complement of -3 is
    # FFFDh
    assert [found[0x2010][sub].data_type for sub in (1, 2, 3)] == [3, 6, 6]
    assert [found[0x2010][sub].value for sub in (2, 3)] == [85, 86]
    assert int(found[0x2010][1].value or 0) & 0xFFFF == 0xFFFD
    assert found[0x2011][1].value == 70000


def test_our_own_reader_mends_nothing_in_it() -> None:
    text = dcf(load_profile("beckhoff-ax2000"), {"friction_current": 170}, None)
    eds = parse_eds(text.encode(), "changes.dcf")
    assert eds.mended == ()
    entry = eds.entry(0x36A4, 1)
    assert entry is not None
    assert entry.type == "i32"
