"""What a PDO carries, byte for byte.

CiA 301, 7.5.2.36 – little endian, in the order of its mapping.
"""

from __future__ import annotations

import pytest

from drivers.canopen.pdo import Objects, Pdo
from profiles.address import CanopenAddress
from profiles.errors import ProfileError


def at(index: int, kind: str, sub: int = 0) -> CanopenAddress:
    return CanopenAddress(index=index, sub=sub, type=kind)


CONTROL, TORQUE, POSITION = at(0x6040, "u16"), at(0x6071, "i16"), at(0x607A, "i32")


def rpdo() -> Pdo:
    return Pdo(0x1400, 255, 0x205, [CONTROL, TORQUE, POSITION])


def mapped(*entries: int) -> Objects:
    found = {(0x1400, 1): 0x205, (0x1400, 2): 255, (0x1600, 0): len(entries)}
    return found | {(0x1600, n): entry for n, entry in enumerate(entries, 1)}


def test_in_the_profile_s_order() -> None:
    pdo = rpdo()
    assert pdo.entries == [0x60400010, 0x60710010, 0x607A0020]
    assert pdo.pack((0x0F, -250, 70000)).hex(" ") == "0f 00 06 ff 70 11 01 00"
    assert pdo.unpack(bytes.fromhex("0f 00 06 ff 70 11 01 00")) == (0x0F, -250, 70000)


def test_as_wide_as_the_drive_has_it() -> None:
    pdo = Pdo(0x1400, 255, 0x205, [CONTROL, TORQUE])
    pdo.lay_out({TORQUE: 4})
    assert pdo.entries == [0x60400010, 0x60710020]
    assert pdo.pack((0x0F, -250)).hex(" ") == "0f 00 06 ff ff ff"
    with pytest.raises(ProfileError, match=r"10 bytes as the drive has them .*6071h:4"):
        rpdo().lay_out({TORQUE: 4})


def test_as_the_drive_has_mapped_it() -> None:
    """Another order, another object between, which is sent as it reads,
    and room for nothing (0005h)."""
    pdo = rpdo()
    there = mapped(0x607A0020, 0x60600008, 0x60710010, 0x00050008)
    assert pdo.missing_in(there) == ["6040h"]
    there = mapped(0x60710010, 0x60600008, 0x60400010, 0x00050008)
    pdo = Pdo(0x1400, 255, 0x205, [CONTROL, TORQUE])
    assert pdo.missing_in(there) == []
    pdo.adopt(there, lambda index, sub: {(0x6060, 0): 0x0A}[index, sub])
    assert pdo.pack((0x0F, -250)).hex(" ") == "06 ff 0a 0f 00 00"
    assert pdo.unpack(bytes.fromhex("06 ff 0a 0f 00 00")) == (0x0F, -250)
    assert pdo.size == 6
