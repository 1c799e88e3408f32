"""The CANopen cycle and its PDO parameters, frame by frame."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Collection

import pytest

from drivers.canopen.adapters import open_bus
from drivers.canopen.bus import CanopenBus
from drivers.canopen.bus_state import BUS_OFF, NO_ACK, PASSIVE, words
from drivers.canopen.wire import CanWire, NoAnswer
from drivers.errors import LinkError, LinkLost, PreflightRefused
from drivers.pace import WallPace
from profiles.errors import UsageError
from profiles.library import load_profile
from tests.raising import raises
from tests.wire.canopen_peer import NODE, SHORT, Frame, Peer, scripted, wire

# -- the cycle ------------------------------------------------------------------------------------


def running(
    more: dict[tuple[int, int], int] | None = None,
    state: str | None = None,
    *,
    awaits_sync: bool = False,
    read_only: Collection[tuple[int, int]] = (),
) -> tuple[CanopenBus, Peer, list[Frame]]:
    """A bus of the generic profile in its cycle; the list is what the node says to each SYNC.

    `more` : objects that it has beside; `state` : what its heartbeat said before
    """
    tpdo: list[Frame] = [(0x185, "37 02 10 27 00 00 19 00")]
    objects = {
        (0x1400, 1): 0x205, (0x1400, 2): 255, (0x1600, 0): 0, (0x1800, 1): 0x185, (0x1800, 2): 1,
        (0x1A00, 0): 0, (0x1017, 0): 0, **(more or {}),
    }  # fmt: skip

    def answer(cob_id: int, data: bytes) -> list[Frame]:
        if cob_id == 0x080:
            return list(tpdo)
        if cob_id != 0x605:
            return []
        index, sub = data[1] | data[2] << 8, data[3]
        head = f"{data[1]:02X} {data[2]:02X} {sub:02X}"
        if data[0] == 0x40:
            value = objects.get((index, sub), 0).to_bytes(4, "little").hex(" ")
            return [(0x585, f"{'4B' if index in SHORT else '43'} {head} {value}")]
        if (index, sub) in read_only:
            return [(0x585, f"80 {head} 02 00 01 06")]
        objects[index, sub] = int.from_bytes(data[4:], "little")
        return [(0x585, f"60 {head} 00 00 00 00")]

    node, peer = wire(answer, awaits_sync=awaits_sync)
    bus = CanopenBus(node, load_profile("cia402"), WallPace(0.001))
    if state is not None:
        peer.say(0x705, state)
        node.drain()
        node.restarted = False  # it was before the job
    peer.changes = bus.changes()
    bus.start((0x0F, 0, 0))
    return bus, peer, tpdo


def test_the_cycle_is_rpdo_sync_tpdo() -> None:
    bus, peer, _ = running()
    mapping = [text for cob_id, text in peer.sent if text.startswith(("23 00 16", "2F 00 16"))]
    # 1600h: none, then 6040h 16 bits, 6071h 16 bits, 607Ah 32 bits, then three
    assert mapping == [
        "2F 00 16 00 00 00 00 00", "23 00 16 01 10 00 40 60", "23 00 16 02 10 00 71 60",
        "23 00 16 03 20 00 7A 60", "2F 00 16 00 03 00 00 00",
    ]  # fmt: skip
    # a producer heartbeat of 100 ms is asked for, the node is started, and hears ours before it is
    # enabled
    assert (0x605, "2B 17 10 00 64 00 00 00") in peer.sent
    assert peer.sent[-2:] == [(0x000, "01 05"), (0x77F, "05")]
    del peer.sent[:]
    exchange = bus.exchange((0x0F, -250, 0))
    assert exchange.values == (0x0237, 10000, 25)
    assert [f for f in peer.sent if f[0] != 0x77F] == [
        (0x205, "0F 00 06 FF 00 00 00 00"),
        (0x080, ""),
    ]


@pytest.mark.parametrize(
    "answer",
    [
        [],
        [(0x186, "37 02 10 27 00 00 19 00")],  # another node's
        [(0x185, "37 02 10 27")],  # truncated
    ],
)
def test_three_cycles_without_a_whole_tpdo_are_a_lost_link(answer: list[Frame]) -> None:
    bus, peer, tpdo = running()
    tpdo[:] = answer
    del peer.sent[:]
    with pytest.raises(LinkLost, match="no TPDO from node 5 for 3 cycles"):
        bus.exchange((0x0F, 0, 0))
    assert sum(cob_id == 0x080 for cob_id, _ in peer.sent) == 3


def test_a_tpdo_that_came_twice_or_late_is_not_the_next_cycle_s() -> None:
    bus, _, tpdo = running()
    tpdo[:] = [(0x185, "37 02 10 27 00 00 19 00"), (0x185, "37 02 99 99 00 00 19 00")]
    assert bus.exchange((0x0F, 0, 0)).values[1] == 10000
    tpdo[:] = [(0x185, "37 02 11 27 00 00 19 00")]
    assert bus.exchange((0x0F, 0, 0)).values[1] == 10001


def test_a_node_that_boots_in_mid_run_is_a_lost_link() -> None:
    bus, peer, _ = running()
    peer.say(0x705, "00")
    with pytest.raises(LinkLost, match="node 5 has restarted"):
        bus.exchange((0x0F, 0, 0))


def test_a_heartbeat_that_stops_is_a_lost_link_within_three_of_them() -> None:
    bus, peer, _ = running()
    peer.say(0x705, "05")
    bus.exchange((0x0F, 0, 0))
    with pytest.raises(LinkLost, match="no heartbeat from node 5 for 3"):
        exchange_for_ever(bus)


def exchange_for_ever(bus: CanopenBus) -> None:
    for _ in range(5000):
        bus.exchange((0x0F, 0, 0))


def test_the_state_that_a_silent_node_told_last_is_said() -> None:
    bus, peer, tpdo = running()
    tpdo.clear()
    peer.say(0x705, "04")
    with raises(LinkLost, "link.tpdo"):
        bus.exchange((0x0F, 0, 0))


def test_an_emergency_is_kept_until_it_is_reset() -> None:
    bus, peer, _ = running()
    peer.say(0x085, "11 86 21 00 00 00 00 00")
    bus.exchange((0x0F, 0, 0))
    assert (
        bus.trouble() == "emergency 8611h (following error), error register 21h (generic, profile)"
    )
    peer.say(0x085, "00 00 00 00 00 00 00 00")
    bus.exchange((0x0F, 0, 0))
    assert bus.trouble() == ""


def test_a_drive_that_says_who_stopped_beating_says_it_in_words() -> None:
    bus, peer, _ = running()
    peer.say(0x085, "30 81 11 00 00 00 00 00")
    bus.exchange((0x0F, 0, 0))
    assert bus.trouble() == (
        "emergency 8130h (heartbeat of the master lost, or guarding), error register 11h "
        "(generic, communication)"
    )


def test_a_dead_producer_of_sync_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """With sync=bus another device paces the cycle; its silence is not the node's."""
    monkeypatch.setattr(
        "drivers.canopen.bus.check_sync", lambda wire, cycle: None
    )  # it was there before the run
    bus, _, _ = running(awaits_sync=True)
    with pytest.raises(
        LinkLost, match="no SYNC on the bus for 3 cycles of 1 ms: its producer has stopped"
    ):
        bus.exchange((0x0F, 0, 0))


def test_a_transfer_that_we_abort_names_its_object() -> None:
    """CiA 301, 7.2.4.3.17: the multiplexer of the transfer stands in the abort."""
    node, peer = wire(scripted("41 08 10 00 0C 00 00 00", "10 74 77 69 6E 20 6F 66"))
    with pytest.raises(LinkError):  # the toggle bit of the segment is wrong: 05030000h
        node.upload(0x1008, 0)
    assert peer.sent[-1] == (0x605, "80 08 10 00 00 00 03 05")


@pytest.mark.parametrize(
    ("answer", "value"),
    [
        ("43 72 60 00 E8 03 00 00", 1000),  # four bytes, where the profile has two
        ("4B 72 60 00 E8 03 AA BB", 1000),
        ("42 72 60 00 E8 03 AA BB", 1000),  # without a size the profile's counts
    ],
)
def test_a_value_is_as_wide_as_the_drive_says(answer: str, value: int) -> None:
    node, _ = wire(scripted(answer))
    profile = load_profile("cia402")
    bus = CanopenBus(node, profile, WallPace(0.001))
    assert bus.read(profile.parameters["max_torque"].address) == value


def test_a_value_goes_back_as_wide_as_it_came() -> None:
    node, peer = wire(scripted("43 72 60 00 E8 03 00 00", "60 72 60 00 00 00 00 00"))
    profile = load_profile("cia402")
    bus = CanopenBus(node, profile, WallPace(0.001))
    bus.read(profile.parameters["max_torque"].address)
    bus.write(profile.parameters["max_torque"].address, 500)
    assert peer.sent[-1] == (0x605, "23 72 60 00 F4 01 00 00")


def test_a_width_that_is_refused_is_asked_and_tried_again() -> None:
    refused = "80 72 60 00 10 00 07 06"  # 06070010h
    node, peer = wire(scripted(refused, "43 72 60 00 E8 03 00 00", "60 72 60 00 00 00 00 00"))
    profile = load_profile("cia402")
    CanopenBus(node, profile, WallPace(0.001)).write(profile.parameters["max_torque"].address, 500)
    assert [text for _, text in peer.sent] == [
        "2B 72 60 00 F4 01 00 00", "40 72 60 00 00 00 00 00", "23 72 60 00 F4 01 00 00",
    ]  # fmt: skip


def test_one_byte_where_four_are_is_a_number_of_entries() -> None:
    node, _ = wire(scripted("4F 76 60 00 06 00 00 00"))
    profile = load_profile("cia402")
    bus = CanopenBus(node, profile, WallPace(0.001))
    with pytest.raises(LinkError, match=r"6076h:00 has 1 byte .* behind sub-index 1"):
        bus.read(profile.parameters["rated_torque"].address)


def test_a_node_that_boots_before_it_is_enabled_is_a_lost_link() -> None:
    """What was set in it is gone: mode, limits, mapping."""
    bus, peer, _ = running()
    bus._running = False
    peer.say(0x705, "00")
    with pytest.raises(LinkLost, match="node 5 has restarted"):
        bus.start((0x0F, 0, 0))


def test_a_stop_that_the_node_has_no_time_for_is_known_from_its_answer() -> None:
    bus, peer, _ = running()
    profile = load_profile("cia402")
    control = profile.parameters["controlword"].address
    bus.post(control, 0x0002)
    peer.waiting[:] = [m for m in peer.waiting if m.arbitration_id != 0x585]
    peer.say(0x585, "80 40 60 00 22 00 00 08")
    assert bus.refused_posts() == []
    bus.read(profile.parameters["statusword"].address)
    assert bus.refused_posts() == [(control, 0x0002)]
    assert bus.refused_posts() == []


def test_a_mapping_whose_count_alone_can_be_written_is_left_whole() -> None:
    """Some drives take 1600h:00 = 0 and refuse the entries.

    What lies there serves, or is counted again.
    """
    there = {
        (0x1600, 0): 3,
        (0x1600, 1): 0x607A0020,
        (0x1600, 2): 0x60400010,
        (0x1600, 3): 0x60710010,
    }
    bus, peer, _ = running(there, read_only={(0x1600, 1), (0x1600, 2), (0x1600, 3)})
    del peer.sent[:]
    bus.exchange((0x0F, -250, 70000))
    assert (0x205, "70 11 01 00 0F 00 06 FF") in peer.sent
    bus.put_back({name: old for name, (old, _) in peer.changes.items()})
    assert bus._pdos.number(0x1600, 0) == 3
    assert bus._pdos.number(0x1400, 1) == 0x205


def test_a_mapping_that_carries_what_the_job_sets_is_refused() -> None:
    """6080h in the RxPDO would be overwritten by each cycle."""
    there = {
        (0x1600, 0): 3,
        (0x1600, 1): 0x60400010,
        (0x1600, 2): 0x60710010,
        (0x1600, 3): 0x60800020,
    }
    with pytest.raises(
        PreflightRefused, match=r"lacks 607Ah and it carries 6080h:00, which the job sets"
    ):
        running(there, read_only={(0x1600, sub) for sub in range(4)})


# -- the adapter ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("identifier", "data", "text"),
    [
        (0x040, "00 00 00 00 00 00 00 00", BUS_OFF),  # CAN_ERR_BUSOFF
        (0x004, "00 20 00 00 00 00 00 00", PASSIVE),  # CAN_ERR_CRTL, TX passive
        (0x004, "00 10 00 00 00 00 00 00", PASSIVE),  # RX passive
        (0x020, "00 00 00 00 00 00 00 00", NO_ACK),  # CAN_ERR_ACK
        (0x004, "00 40 00 00 00 00 00 00", ""),  # back to error active
        (0x100, "00 00 00 00 00 00 00 00", ""),  # restarted
    ],
)
def test_error_frames_by_linux_can_error_h(identifier: int, data: str, text: str) -> None:
    assert words(identifier, bytes.fromhex(data)) == text
    node, peer = wire(scripted())
    peer.say(identifier, data, error=True)
    with pytest.raises(NoAnswer) as caught:
        node.upload(0x6041, 0)
    assert node.error_frames == 1
    assert (text or "is the drive on?") in str(caught.value)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")
def test_lines_that_come_together_split_or_with_acknowledgements_are_all_read() -> None:
    """Lawicel's CAN232: CR or z CR after a sent frame, BELL for one that was not."""
    master, slave = os.openpty()
    bus = open_bus("slcan", os.ttyname(slave), 500_000, 1.0)
    node = CanWire(bus, NODE, 1.0)
    try:
        node.listen_tpdo(0x185)
        for chunk in (b"z\r\a\rt705105\rt18524", b"237\rt705114\r\r"):
            os.write(master, chunk)
            node.drain()
        assert node.heartbeat_state == 0x14
        os.write(master, b"t1852")
        node.drain()
        assert node.take_tpdo(0) is None
        os.write(master, b"4237\r")
        assert node.take_tpdo(1.0) == b"\x42\x37"
        assert node.garbled == 0
    finally:
        node.close()
        os.close(slave)
        os.close(master)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")
@pytest.mark.parametrize(
    "garbage",
    [b"t58", b"tXYZ8\r", b"t5858ZZ\r", b"t585\xff\r", b"\r\r\r", b"t5859" + b"0" * 30 + b"\r"],
)
def test_one_garbled_line_does_not_end_the_reception(garbage: bytes) -> None:
    master, slave = os.openpty()
    bus = open_bus("slcan", os.ttyname(slave), 500_000, 1.0)
    node = CanWire(bus, NODE, 1.0)

    def answer() -> None:
        heard = b""
        while b"t6058" not in heard:
            heard += os.read(master, 100)
        end = b"" if garbage.endswith(b"\r") else b"\r"
        os.write(master, garbage + end + b"t58584B41600037020000\r")

    thread = threading.Thread(target=answer)
    thread.start()
    try:
        assert node.upload(0x6041, 0) == b"\x37\x02"
    finally:
        thread.join()
        node.close()
        os.close(master)
        os.close(slave)


def test_a_pdo_goes_back_off_first_and_on_last() -> None:
    """CiA 301, 7.5.2.36.

    A mapping is changed while the PDO is off, and has no entries meanwhile.
    """
    bus, peer, _ = running()
    del peer.sent[:]
    old = {"1400h:01": 0x205, "1400h:02": 254, "1600h:00": 1, "1600h:01": 0x60400010}
    assert bus.put_back(old)
    writes = [text for cob_id, text in peer.sent if cob_id == 0x605 and not text.startswith("40")]
    assert writes == [
        "23 00 14 01 05 02 00 80", "2F 00 14 02 FE 00 00 00", "2F 00 16 00 00 00 00 00",
        "2F 00 16 00 01 00 00 00", "23 00 14 01 05 02 00 00",  # its entry lies there as it was
    ]  # fmt: skip
    assert not bus.put_back(old), "all is as before"


def test_entries_that_do_not_count_go_back_too() -> None:
    """Ours lie in 1600h:02 and 03.

    What was there comes back as soon as somebody counts them again.
    """
    left = {(0x1600, 0): 1, (0x1600, 1): 0x60400010, (0x1600, 2): 0x60600008, (0x1600, 3): 0}
    bus, peer, _ = running(left)
    old = {name: before for name, (before, _) in peer.changes.items()}
    assert {old[f"1600h:{sub:02}"] for sub in range(4)} == set(left.values())
    del peer.sent[:]
    assert bus.put_back(old)
    writes = [text for cob_id, text in peer.sent if cob_id == 0x605 and text.startswith("2")]
    mapping = [text for text in writes if text[3:8] == "00 16"]
    assert mapping == [
        "2F 00 16 00 00 00 00 00", "23 00 16 02 08 00 60 60", "23 00 16 03 00 00 00 00",
        "2F 00 16 00 01 00 00 00",
    ]  # fmt: skip
    assert not bus.put_back(old), "all is as before"


@pytest.mark.parametrize(
    ("state", "command"), [("7F", "80 05"), ("05", "01 05"), ("04", "02 05"), ("00", "80 05")]
)
def test_a_node_gets_the_state_back_that_its_heartbeat_told(state: str, command: str) -> None:
    bus, peer, _ = running(state=state)
    assert peer.sent[-2] == (0x000, "01 05")
    bus.put_back({name: old for name, (old, _) in peer.changes.items()})
    assert [text for cob_id, text in peer.sent if cob_id == 0][-1] == command


def test_a_node_whose_state_nobody_told_is_left_as_its_pdos_need_it() -> None:
    bus, peer, _ = running()
    bus.put_back({name: old for name, (old, _) in peer.changes.items()})
    assert [text for cob_id, text in peer.sent if cob_id == 0] == [
        "80 05",
        "01 05",
        "80 05",
        "80 05",
    ]


@pytest.mark.parametrize(
    ("old", "why"),
    [
        ({"6040h:00": 15}, "'6040h:00' is no parameter of the profile, and none of its PDOs"),
        ({"1010h:01": 0x65766173}, "none of its PDOs"),
        ({"../1400h:01": 0}, "none of its PDOs"),
        ({"1017h:00": -1}, "does not fit into 2 bytes"),
        ({"1400h:02": 256}, "does not fit into 1 bytes"),
        ({"1400h:01": 0x205}, "only a part of a PDO: 1400h:02 is missing"),
    ],
)
def test_a_journal_that_names_what_it_must_not_changes_nothing(
    old: dict[str, int], why: str
) -> None:
    bus, peer, _ = running()
    del peer.sent[:]
    with pytest.raises(UsageError, match=why):
        bus.put_back(old)
    assert peer.sent == []
