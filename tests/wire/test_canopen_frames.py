"""What goes over CAN, frame for frame against the words of CiA 301, and what hostile peers send."""

from __future__ import annotations

import threading
from binascii import crc_hqx
from contextlib import suppress

import pytest

from drivers.canopen.sync import sync_period
from drivers.canopen.wire import NoAnswer
from drivers.errors import AccessDenied, WriteDenied
from profiles.errors import TwoRelayError
from tests.wire.canopen_peer import Frame, scripted, wire


@pytest.mark.parametrize("stalled", [range(0), range(4), range(8, 13), range(16, 20)])
def test_the_period_of_sync_is_found_although_this_computer_stalls(stalled: range) -> None:
    due = [0.01 * n for n in range(20)]
    assert (
        sync_period([due[stalled[-1]] + 0.003 if n in stalled else due[n] for n in range(20)])
        == 0.01
    )


# -- CiA 301, 7.2.4.3 -----------------------------------------------------------------------------


def test_an_expedited_upload() -> None:
    node, peer = wire(scripted("43 76 60 00 E8 03 00 00"))
    assert node.upload(0x6076, 0) == b"\xe8\x03\x00\x00"
    assert peer.sent == [(0x605, "40 76 60 00 00 00 00 00")]


def test_a_segmented_upload() -> None:
    # 12 bytes: size in the first answer; then 7 and 5 (n = 2, c = 1), the toggle bit alternating
    node, peer = wire(
        scripted(
            "41 08 10 00 0C 00 00 00", "00 74 77 69 6E 20 6F 66", "15 20 65 6C 6D 6F 00 00",
        )
    )  # fmt: skip
    assert node.upload(0x1008, 0) == b"twin of elmo"
    assert [text for _, text in peer.sent] == [
        "40 08 10 00 00 00 00 00", "60 00 00 00 00 00 00 00", "70 00 00 00 00 00 00 00",
    ]  # fmt: skip


def test_a_segmented_download() -> None:
    node, peer = wire(
        scripted("60 08 10 00 00 00 00 00", "20 00 00 00 00 00 00 00", "30 00 00 00 00 00 00 00")
    )
    node.download(0x1008, 0, b"0123456789")
    # 21h: size indicated, 10 bytes; then 7 bytes, and 3 with n = 4, c = 1
    assert [text for _, text in peer.sent] == [
        "21 08 10 00 0A 00 00 00", "00 30 31 32 33 34 35 36", "19 37 38 39 00 00 00 00",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("code", "text"),
    [
        ("00 00 02 06", "Object does not exist"),
        ("22 00 00 08", "device state"),
        ("30 00 09 06", "Value range of parameter exceeded"),
    ],
)
def test_an_abort_is_a_refusal_in_words(code: str, text: str) -> None:
    node, _ = wire(scripted(f"80 71 60 00 {code}"))
    with pytest.raises(AccessDenied, match=r"6071h:00: node 5 refuses it: .*") as caught:
        node.download(0x6071, 0, b"\0\0")
    assert text.lower() in str(caught.value).lower()


def test_a_block_upload() -> None:
    """CiA 301, 7.2.4.3.13: A4h with CRC, C6h with size; A3h; segments; A2h; C1h with CRC; A1h."""
    text = b"0123456789"
    crc = crc_hqx(text, 0).to_bytes(2, "little").hex(" ")  # CRC-16-CCITT of the standard
    node, peer = wire(
        scripted(
            "C6 21 10 00 0A 00 00 00",
            [(0x585, "01 30 31 32 33 34 35 36"), (0x585, "82 37 38 39 00 00 00 00")],
            f"D1 {crc} 00 00 00 00 00",  # four bytes of the last segment are none
        )
    )
    assert node.upload_large(0x1021, 0) == text
    assert [sent for _, sent in peer.sent] == [
        "A4 21 10 00 7F 00 00 00", "A3 00 00 00 00 00 00 00", "A2 02 7F 00 00 00 00 00",
        "A1 00 00 00 00 00 00 00",
    ]  # fmt: skip


def test_a_node_without_block_transfer_is_read_in_segments() -> None:
    node, _ = wire(
        scripted(
            "80 21 10 00 01 00 04 05", "41 21 10 00 08 00 00 00", "00 61 62 63 64 65 66 67",
            "1D 68 00 00 00 00 00 00",
        )
    )  # fmt: skip
    assert node.upload_large(0x1021, 0) == b"abcdefgh"


# -- peers that are not as they should be ---------------------------------------------------------


def test_the_answer_of_another_node_is_not_ours() -> None:
    node, _ = wire(
        scripted([(0x586, "4B 41 60 00 FF FF 00 00"), (0x585, "4B 41 60 00 37 02 00 00")])
    )
    assert node.upload(0x6041, 0) == b"\x37\x02"


@pytest.mark.parametrize(
    "short", ["4B 41 60 00 37 02", "4B 41 60 00 37 02 00", "4B 41 60 00 37 02 00 00"]
)
def test_an_answer_may_be_as_short_as_its_value(short: str) -> None:
    """CiA 301 has eight bytes in each; some servers send those that mean something."""
    node, _ = wire(scripted([(0x585, short)]))
    assert node.upload(0x6041, 0) == b"\x37\x02"


def test_a_download_may_be_confirmed_by_four_bytes() -> None:
    node, _ = wire(scripted([(0x585, "60 40 60 00")]))
    node.download(0x6040, 0, b"\x06\x00")


@pytest.mark.parametrize(
    "bad",
    [
        [(0x585, "4B 41 60 00 37")],  # one of two bytes
        [(0x585, "")],
        [],
    ],
)
def test_a_truncated_answer_is_no_answer(bad: list[Frame]) -> None:
    node, peer = wire(scripted(bad))
    with pytest.raises(NoAnswer, match=r"node 5 does not answer to SDO 6041h:00 within 0\.05 s"):
        node.upload(0x6041, 0)
    # nothing is sent twice; the transfer is aborted with 05040000h, time-out
    assert peer.sent == [(0x605, "40 41 60 00 00 00 00 00"), (0x605, "80 41 60 00 00 00 04 05")]


def test_the_answer_to_another_question_is_not_taken_for_ours() -> None:
    """What came late, or twice, belongs to an object that was asked for before."""
    node, _ = wire(
        scripted([(0x585, "4B 77 60 00 11 11 00 00"), (0x585, "4B 41 60 00 37 02 00 00")])
    )
    assert node.upload(0x6041, 0) == b"\x37\x02"


def test_an_answer_that_came_after_its_time_out_is_forgotten() -> None:
    node, peer = wire(scripted([], "4B 41 60 00 37 02 00 00"))
    with pytest.raises(NoAnswer):
        node.upload(0x6077, 0)
    peer.say(0x585, "4B 77 60 00 11 11 00 00")
    assert node.upload(0x6041, 0) == b"\x37\x02"


def test_a_node_that_answers_nonsense_is_no_traceback() -> None:
    for command in range(256):
        node, _ = wire(lambda cob_id, data, c=command: [(0x585, f"{c:02X} 41 60 00 37 02 00 00")])  # type: ignore[misc]
        with suppress(TwoRelayError):
            node.upload(0x6041, 0)


@pytest.mark.parametrize(
    ("code", "busy"),
    [
        ("20 00 00 08", True), ("21 00 00 08", True), ("22 00 00 08", True),
        ("23 00 00 08", False), ("00 00 02 06", False), ("30 00 09 06", False), ("00 00 04 05",
        False),
    ],
)  # fmt: skip
def test_aborts_that_may_be_otherwise_a_little_later(code: str, busy: bool) -> None:
    """CiA 301, 7.2.4.3.17: of the application, local control, the present device state."""
    node, _ = wire(scripted(f"80 71 60 00 {code}", f"80 71 60 00 {code}"))
    with pytest.raises(AccessDenied) as read:
        node.upload(0x6071, 0)
    assert not isinstance(read.value, WriteDenied)
    with pytest.raises(WriteDenied) as written:
        node.download(0x6071, 0, b"\0\0")
    assert read.value.busy is written.value.busy is busy


def test_a_node_that_stores_may_take_longer_to_answer() -> None:
    node, peer = wire(lambda cob_id, data: [])
    node._sdo.RESPONSE_TIMEOUT = 0.01
    late = threading.Timer(0.2, peer.say, (0x585, "60 10 10 01 00 00 00 00"))
    late.start()
    with node.answering_within(20.0):
        node.download(0x1010, 1, b"save")
    late.join()
    with pytest.raises(NoAnswer):
        node.upload(0x6041, 0)
