"""The virtual CANopen node, frame by frame against the words of CiA 301."""

from __future__ import annotations

from binascii import crc_hqx

import pytest

from drivers.virtual.axes import AXES
from drivers.virtual.canopen_node import CanopenNode
from drivers.virtual.device import Device
from drivers.virtual.firmware import Firmware

MS = 1_000_000


@pytest.fixture
def node() -> CanopenNode:
    return CanopenNode(Device(Firmware(AXES["bench"]), "step"), 5)


def sdo(node: CanopenNode, request: str) -> str:
    """One request by its bytes; the answer's bytes."""
    answers = node.receive(0x605, bytes.fromhex(request))
    assert [a.cob_id for a in answers] == [0x585]
    return answers[0].data.hex(" ").upper()


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        # expedited upload of 1018h:1, four bytes: scs 2, n 0, e 1, s 1
        ("40 18 10 01 00 00 00 00", "43 18 10 01 57 74 00 00"),
        # expedited upload of 6041h, two bytes: n 2; switch on disabled, remote
        ("40 41 60 00 00 00 00 00", "4B 41 60 00 40 02 00 00"),
        # expedited upload of 6061h, one byte: n 3
        ("40 61 60 00 00 00 00 00", "4F 61 60 00 00 00 00 00"),
        # expedited download of 6060h = 10, one byte: ccs 1, n 3, e 1, s 1
        ("2F 60 60 00 0A 00 00 00", "60 60 60 00 00 00 00 00"),
        # no such object: 06020000h; no such sub-index: 06090011h
        ("40 00 21 00 00 00 00 00", "80 00 21 00 00 00 02 06"),
        ("40 18 10 09 00 00 00 00", "80 18 10 09 11 00 09 06"),
        # read-only: 06010002h; wrong length: 06070010h; value out of range: 06090030h
        ("2B 41 60 00 00 00 00 00", "80 41 60 00 02 00 01 06"),
        ("23 60 60 00 0A 00 00 00", "80 60 60 00 10 00 07 06"),
        ("2B 10 20 02 E9 03 00 00", "80 10 20 02 30 00 09 06"),
        # unknown command specifier: 05040001h
        ("E0 18 10 01 00 00 00 00", "80 18 10 01 01 00 04 05"),
    ],
)
def test_sdo_expedited(node: CanopenNode, request_: str, answer: str) -> None:
    assert sdo(node, request_) == answer


def test_sdo_segmented_upload_of_the_device_name(node: CanopenNode) -> None:
    # 1008h "tworelay virtual drive", 22 bytes: announced, then 7 + 7 + 7 + 1 with toggled bit
    assert sdo(node, "40 08 10 00 00 00 00 00") == "41 08 10 00 16 00 00 00"
    assert sdo(node, "60 00 00 00 00 00 00 00") == "00 74 77 6F 72 65 6C 61"
    assert sdo(node, "70 00 00 00 00 00 00 00") == "10 79 20 76 69 72 74 75"
    assert sdo(node, "60 00 00 00 00 00 00 00") == "00 61 6C 20 64 72 69 76"
    assert sdo(node, "70 00 00 00 00 00 00 00") == "1D 65 00 00 00 00 00 00"


def test_a_wrong_toggle_bit_aborts(node: CanopenNode) -> None:
    sdo(node, "40 08 10 00 00 00 00 00")
    assert sdo(node, "70 00 00 00 00 00 00 00") == "80 00 00 00 00 00 03 05"


def test_sdo_segmented_download(node: CanopenNode) -> None:
    # 6072h = 500 in one segment: ccs 0, n 5, c 1
    assert sdo(node, "21 72 60 00 02 00 00 00") == "60 72 60 00 00 00 00 00"
    assert sdo(node, "0B F4 01 00 00 00 00 00") == "20 00 00 00 00 00 00 00"
    assert sdo(node, "40 72 60 00 00 00 00 00") == "4B 72 60 00 F4 01 00 00"


def test_nmt_boot_up_and_heartbeat(node: CanopenNode) -> None:
    assert node.receive(0x000, b"\x82\x05") == [(0x705, b"\x00")]
    sdo(node, "2B 17 10 00 64 00 00 00")  # heartbeat every 100 ms
    node.device.firmware.advance(100 * MS)
    assert node.poll() == [(0x705, b"\x7f")]
    node.receive(0x000, b"\x01\x05")
    node.device.firmware.advance(100 * MS)
    # and the event of TPDO1's 255: its statusword says something new
    assert node.poll() == [(0x705, b"\x05"), (0x185, b"\x40\x02")]
    assert node.receive(0x000, b"\x01\x06") == [], "another node is meant"


def map_pdos(node: CanopenNode) -> None:
    """RPDO 1: controlword, target torque; TPDO 1: statusword, position, torque, every SYNC."""
    for request in (
        "23 00 14 01 05 02 00 80", "2F 00 14 02 FF 00 00 00", "2F 00 16 00 00 00 00 00",
        "23 00 16 01 10 00 40 60", "23 00 16 02 10 00 71 60", "2F 00 16 00 02 00 00 00",
        "23 00 14 01 05 02 00 00",
        "23 00 18 01 85 01 00 80", "2F 00 18 02 01 00 00 00", "2F 00 1A 00 00 00 00 00",
        "23 00 1A 01 10 00 41 60", "23 00 1A 02 20 00 64 60", "23 00 1A 03 10 00 77 60",
        "2F 00 1A 00 03 00 00 00", "23 00 18 01 85 01 00 00",
    ):  # fmt: skip
        assert sdo(node, request).startswith("60"), request
    node.receive(0x000, b"\x01\x05")


def test_rpdo_in_sync_and_tpdo_out(node: CanopenNode) -> None:
    map_pdos(node)
    sdo(node, "2F 60 60 00 0A 00 00 00")
    for word in (b"\x06\x00", b"\x07\x00", b"\x0f\x00"):
        assert node.receive(0x205, word + b"\x00\x00") == []
    node.receive(0x205, b"\x0f\x00\xf4\x01")  # 500 per mille
    for _ in range(10):
        frames = node.receive(0x080, b"")
    assert [f.cob_id for f in frames] == [0x185]
    status, position, torque = frames[0].data[:2], frames[0].data[2:6], frames[0].data[6:]
    assert status == b"\x37\x12"
    assert torque == b"\xf4\x01"
    # 8 ms under 0.4 N.m net on 1e-3 kg.m2: 0.0128 rad of 131072 counts a turn
    assert int.from_bytes(position, "little") == pytest.approx(267, abs=4)


def test_mapping_rules(node: CanopenNode) -> None:
    assert sdo(node, "2F 00 16 00 00 00 00 00") == "80 00 16 00 22 00 00 08", "the PDO is active"
    sdo(node, "23 00 14 01 05 02 00 80")
    sdo(node, "2F 00 16 00 00 00 00 00")
    assert sdo(node, "23 00 16 01 10 00 99 60") == "80 00 16 01 41 00 04 06", "no such object"
    for sub in (1, 2, 3):
        sdo(node, f"23 00 16 0{sub} 20 00 7A 60")
    assert sdo(node, "2F 00 16 00 03 00 00 00") == "80 00 16 00 42 00 04 06", "12 bytes"


def test_a_silent_heartbeat_stops_the_drive_with_an_emergency(node: CanopenNode) -> None:
    map_pdos(node)
    sdo(node, "23 16 10 01 32 00 7F 00")  # node 127 every 50 ms
    sdo(node, "2B 07 60 00 01 00 00 00")
    sdo(node, "2F 60 60 00 0A 00 00 00")
    for word in (b"\x06\x00", b"\x07\x00", b"\x0f\x00"):
        node.receive(0x205, word + b"\x00\x00")
    node.receive(0x77F, b"\x05")
    node.device.firmware.advance(60 * MS)
    assert node.poll() == [(0x085, b"\x30\x81\x11\x00\x00\x00\x00\x00")]
    node.device.firmware.advance(60 * MS)
    assert not node.device.firmware.energised


def test_a_silent_rpdo_stops_the_drive(node: CanopenNode) -> None:
    map_pdos(node)
    sdo(node, "2B 00 14 05 14 00 00 00")  # event timer 20 ms
    sdo(node, "2F 60 60 00 0A 00 00 00")
    for word in (b"\x06\x00", b"\x07\x00", b"\x0f\x00"):
        node.receive(0x205, word + b"\x00\x00")
    assert node.device.firmware.energised
    node.device.firmware.advance(25 * MS)
    assert node.poll()[0].data[:2] == b"\x50\x82"
    node.device.firmware.advance(60 * MS)
    assert not node.device.firmware.energised


def test_a_short_rpdo_is_reported_and_not_taken(node: CanopenNode) -> None:
    map_pdos(node)
    assert node.receive(0x205, b"\x06") == [(0x085, b"\x10\x82\x11\x00\x00\x00\x00\x00")]


@pytest.mark.parametrize("data", [b"", b"\x40", b"\x40\x18\x10", bytes(9)])
def test_malformed_requests_get_no_answer(node: CanopenNode, data: bytes) -> None:
    assert node.receive(0x605, data) == []


def test_a_block_upload_with_a_segment_lost_and_sent_again(node: CanopenNode) -> None:
    """CiA 301, 7.2.4.3.14.

    The client confirms the last segment in order, and gets the rest again.
    """

    def ask(request: str) -> list[str]:
        answers = node.receive(0x605, bytes.fromhex(request))
        return [a.data.hex(" ").upper() for a in answers]

    # 1008h "tworelay virtual drive", 22 bytes: four segments; blocks of two
    assert ask("A4 08 10 00 02 00 00 00") == ["C6 08 10 00 16 00 00 00"]
    assert ask("A3 00 00 00 00 00 00 00") == [
        "01 74 77 6F 72 65 6C 61", "02 79 20 76 69 72 74 75",
    ]  # fmt: skip
    assert ask("A2 01 02 00 00 00 00 00") == [
        "01 79 20 76 69 72 74 75", "02 61 6C 20 64 72 69 76",
    ]  # fmt: skip
    assert ask("A2 02 02 00 00 00 00 00") == ["81 65 00 00 00 00 00 00"]
    crc = crc_hqx(b"tworelay virtual drive", 0).to_bytes(2, "little").hex(" ").upper()
    assert ask("A2 01 02 00 00 00 00 00") == [f"D9 {crc} 00 00 00 00 00"]  # six bytes are none
    assert ask("A1 00 00 00 00 00 00 00") == []
    assert ask("A2 01 02 00 00 00 00 00")[0].startswith("80")


def test_a_download_in_segments_is_as_long_as_it_was_announced(node: CanopenNode) -> None:
    # 6060h: ccs 1, e 0, s 1, two bytes announced; one comes (n 6, last): 06070010h
    assert sdo(node, "21 60 60 00 02 00 00 00") == "60 60 60 00 00 00 00 00"
    assert sdo(node, "0D 0A 00 00 00 00 00 00")[:2] == "80"
    assert sdo(node, "21 60 60 00 01 00 00 00") == "60 60 60 00 00 00 00 00"
    assert sdo(node, "0D 0A 00 00 00 00 00 00") == "20 00 00 00 00 00 00 00"


def energised(node: CanopenNode) -> bool:
    return (
        int.from_bytes(bytes.fromhex(sdo(node, "40 41 60 00 00 00 00 00"))[4:6], "little") & 0x6F
        == 0x27
    )


def enable(node: CanopenNode) -> None:
    sdo(node, "2F 60 60 00 0A 00 00 00")
    for word in ("06", "07", "0F"):
        sdo(node, f"2B 40 60 00 {word} 00 00 00")
        node.device.firmware.advance(100 * MS)
    assert energised(node)


def test_a_fault_is_reset_by_an_edge_and_not_by_a_level(node: CanopenNode) -> None:
    """CiA 402: transition 15 is the rise of bit 7 of the controlword."""

    def write(word: int) -> bool:
        """The controlword; whether there is a fault, then."""
        node.receive(0x605, bytes.fromhex(f"2B 40 60 00 {word:02X} 00 00 00"))
        return bool(bytes.fromhex(sdo(node, "40 41 60 00 00 00 00 00"))[4] & 0x08)

    assert not write(0x80)
    node.device.firmware.trip(0x8611)
    node.device.firmware.advance(500 * MS)
    node.poll()
    assert write(0x80), "the bit stood already"
    assert write(0x00)
    assert not write(0x80)


@pytest.mark.parametrize(("option", "enabled"), [(0, True), (1, False), (2, False), (3, False)])
def test_a_node_that_is_stopped_has_lost_its_connection(
    node: CanopenNode, option: int, enabled: bool
) -> None:
    """6007h, abort connection option: 0 no action, 1 fault, 2 disable voltage, 3 quick stop."""
    sdo(node, f"2B 07 60 00 0{option} 00 00 00")
    node.receive(0x000, bytes((0x01, 5)))
    enable(node)
    node.receive(0x000, bytes((0x02, 5)))
    node.device.firmware.advance(500 * MS)
    node.receive(0x000, bytes((0x80, 5)))
    assert energised(node) is enabled


@pytest.mark.parametrize(("behaviour", "state"), [(0, 0x7F), (1, 0x05), (2, 0x04)])
def test_what_a_node_does_when_the_heartbeat_of_its_master_is_lost(
    node: CanopenNode, behaviour: int, state: int
) -> None:
    """1029h:01, communication error: 0 pre-operational (the default), 1 no change, 2 stopped."""
    assert sdo(node, "40 29 10 01 00 00 00 00") == "4F 29 10 01 00 00 00 00"
    sdo(node, f"2F 29 10 01 0{behaviour} 00 00 00")
    sdo(node, "23 16 10 01 32 00 7F 00")  # node 127, 50 ms
    node.receive(0x000, bytes((0x01, 5)))
    node.device.firmware.advance(200 * MS)
    node.poll()
    assert node.state == 0x05, "the first beat begins it"
    node.receive(0x77F, b"\x05")
    node.device.firmware.advance(200 * MS)
    node.poll()
    assert node.state == state


def tpdos(frames: list[tuple[int, bytes]]) -> list[str]:
    return [data.hex(" ") for cob_id, data in frames if cob_id == 0x185]


def test_an_event_driven_tpdo_comes_when_its_values_change(node: CanopenNode) -> None:
    """CiA 301, 7.5.2.37: 255 is the profile's event; CiA 402: a change of the statusword."""
    assert tpdos(node.poll()) == [], "not before it is operational"
    assert tpdos([*node.receive(0x000, b"\x01\x05"), *node.poll()]) == ["40 02"]
    assert tpdos(node.poll()) == [], "nothing has changed"
    node.receive(0x205, b"\x06\x00")
    assert tpdos(node.poll()) == ["31 02"]
    node.receive(0x000, b"\x80\x05")
    node.receive(0x605, bytes.fromhex("2B 40 60 00 07 00 00 00"))
    assert tpdos(node.poll()) == [], "PDOs are for operational nodes"


def test_inhibit_time_keeps_event_driven_tpdos_apart(node: CanopenNode) -> None:
    """1800h:03 in steps of 100 us, written while the PDO does not exist."""
    assert sdo(node, "2B 00 18 03 64 00 00 00") == "80 00 18 03 22 00 00 08"
    assert sdo(node, "23 00 18 01 85 01 00 80").startswith("60")
    assert sdo(node, "2B 00 18 03 64 00 00 00").startswith("60")  # 10 ms
    assert sdo(node, "23 00 18 01 85 01 00 00").startswith("60")
    assert sdo(node, "40 00 18 03 00 00 00 00") == "4B 00 18 03 64 00 00 00"
    node.receive(0x000, b"\x01\x05")
    node.device.firmware.advance(10 * MS)
    assert tpdos(node.poll()) == ["40 02"]
    node.receive(0x205, b"\x06\x00")
    node.device.firmware.advance(9 * MS)
    assert tpdos(node.poll()) == []
    node.device.firmware.advance(1 * MS)
    assert tpdos(node.poll()) == ["31 02"]


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        ("23 00 14 01 06 02 00 00", "80 00 14 01 30 00 09 06"),  # another COB-ID while it exists
        ("2F 00 18 02 F1 00 00 00", "80 00 18 02 30 00 09 06"),  # 241: reserved
        ("2F 00 18 02 FD 00 00 00", "80 00 18 02 30 00 09 06"),  # 253: on request only
        ("2F 00 1A 00 00 00 00 00", "80 00 1A 00 22 00 00 08"),  # a mapping while it exists
    ],
)
def test_pdo_parameters_are_written_by_the_rules(
    node: CanopenNode, request_: str, answer: str
) -> None:
    assert sdo(node, request_) == answer


def test_a_pdo_that_is_too_long_is_taken_and_reported(node: CanopenNode) -> None:
    node.receive(0x000, b"\x01\x05")
    node.poll()
    frames = node.receive(0x205, b"\x06\x00\xff")
    assert (0x085, bytes.fromhex("20 82 11 00 00 00 00 00")) in frames
    assert node.device.firmware.statusword & 0x6F == 0x21


def test_an_error_of_silence_that_is_no_fault_is_gone_with_the_next_heartbeat(
    node: CanopenNode,
) -> None:
    """6007h = 3, quick stop: no fault to be reset, so the error register clears by itself."""
    sdo(node, "2B 07 60 00 03 00 00 00")
    sdo(node, "23 16 10 01 32 00 7F 00")  # node 127 every 50 ms
    for word in (b"\x06\x00", b"\x07\x00", b"\x0f\x00"):
        sdo(node, "2F 60 60 00 0A 00 00 00")
        node.receive(0x605, bytes.fromhex("2B 40 60 00") + word + b"\0\0")
    node.receive(0x77F, b"\x05")
    node.device.firmware.advance(51 * MS)
    assert (0x085, bytes.fromhex("30 81 11 00 00 00 00 00")) in node.poll()
    assert sdo(node, "40 01 10 00 00 00 00 00") == "4F 01 10 00 11 00 00 00"
    assert (0x085, bytes(8)) in node.receive(0x77F, b"\x05")
    assert sdo(node, "40 01 10 00 00 00 00 00") == "4F 01 10 00 00 00 00 00"
