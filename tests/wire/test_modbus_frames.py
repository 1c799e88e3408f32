"""What goes over Modbus TCP, byte for byte against the Modbus Application Protocol V1.1b3."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from drivers.errors import AccessDenied, DriveFault, LinkError, LinkLost
from drivers.modbus.bus import ModbusBus, identify
from drivers.modbus.client import Client, NoAnswer
from drivers.modbus.wires import TcpWire
from drivers.pace import WallPace
from profiles.identity import Identity
from profiles.library import load_profile


@contextmanager
def peer(script: list[tuple[str, str]]) -> Iterator[tuple[int, list[str]]]:
    """A server that expects requests and gives the answers, all as hex; '' answers nothing."""
    heard: list[str] = []
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        connection, _ = listener.accept()
        with connection:
            for _, answer in script:
                data = connection.recv(300)
                heard.append(data.hex(" "))
                if answer:
                    connection.sendall(bytes.fromhex(answer))
            connection.settimeout(5)
            while connection.recv(300):
                pass

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield listener.getsockname()[1], heard
    finally:
        thread.join()
        listener.close()
    assert heard == [request for request, _ in script]


def test_read_holding_registers() -> None:
    # MBAP: transaction 1, protocol 0, length 6, unit 1; FC 03, address 0300h, 2 registers
    script = [("00 01 00 00 00 06 01 03 03 00 00 02", "00 01 00 00 00 07 01 03 04 00 0F 42 40")]
    with peer(script) as (port, _):
        client = Client(TcpWire("127.0.0.1", port), 1, 1.0)
        assert client.read(3, 0x0300, 2) == [0x000F, 0x4240]
        client.close()


def test_write_single_and_multiple_registers() -> None:
    script = [
        ("00 01 00 00 00 06 01 06 01 10 00 0f", "00 01 00 00 00 06 01 06 01 10 00 0F"),
        (
            "00 02 00 00 00 0b 01 10 03 12 00 02 04 00 00 0b b8",
            "00 02 00 00 00 06 01 10 03 12 00 02",
        ),
    ]
    with peer(script) as (port, _):
        client = Client(TcpWire("127.0.0.1", port), 1, 1.0)
        client.write(6, 0x0110, [0x000F])
        client.write(16, 0x0312, [0, 3000])
        client.close()


def test_the_cycle_is_one_fc_23_with_the_profile_s_blocks() -> None:
    # read 0200h..0204h (5), write 0100h..0102h (3): torque -250 per mille, position 0
    request = "00 01 00 00 00 11 01 17 02 00 00 05 01 00 00 03 06 ff 06 00 00 00 00"
    # statusword 1237h, error 0, position -2, torque -249
    answer = "00 01 00 00 00 0D 01 17 0A 12 37 00 00 FF FF FF FE FF 07"
    with peer([(request, answer)]) as (port, _):
        client = Client(TcpWire("127.0.0.1", port), 1, 1.0)
        bus = ModbusBus(client, load_profile("virtual-modbus"), WallPace(0.005))
        found = bus.exchange((-250, 0))
        assert found.values == (0x1237, 0, -2, -249)
        assert found.missed == 0
        bus.close()


def test_an_exception_answer_is_a_refusal_with_its_name() -> None:
    script = [("00 01 00 00 00 06 01 03 99 99 00 01", "00 01 00 00 00 03 01 83 02")]
    with peer(script) as (port, _):
        client = Client(TcpWire("127.0.0.1", port), 1, 1.0)
        with pytest.raises(AccessDenied, match=r"exception 2 \(illegal data address\)"):
            client.read(3, 0x9999, 1)
        client.close()


def test_silence_is_no_answer_and_is_never_sent_again() -> None:
    with peer([("00 01 00 00 00 06 01 03 00 00 00 01", "")]) as (port, heard):
        client = Client(TcpWire("127.0.0.1", port), 1, 0.05)
        with pytest.raises(NoAnswer, match="does not answer within 50 ms"):
            client.read(3, 0, 1)
        assert len(heard) == 1
        client.close()


def test_a_late_answer_is_discarded_by_its_transaction() -> None:
    script = [
        ("00 01 00 00 00 06 01 03 00 00 00 01", ""),
        (
            "00 02 00 00 00 06 01 03 00 00 00 01",
            "00 01 00 00 00 05 01 03 02 AA AA 00 02 00 00 00 05 01 03 02 BB BB",
        ),
    ]
    with peer(script) as (port, _):
        client = Client(TcpWire("127.0.0.1", port), 1, 0.05)
        with pytest.raises(NoAnswer):
            client.read(3, 0, 1)
        assert client.read(3, 0, 1, 1.0) == [0xBBBB]
        client.close()


def test_garbage_is_said_to_be_no_modbus() -> None:
    script = [("00 01 00 00 00 06 01 03 00 00 00 01", b"SSH-2.0-OpenSSH_9.2\r\n".hex())]
    with peer(script) as (port, _):
        client = Client(TcpWire("127.0.0.1", port), 1, 0.1)
        with pytest.raises(LinkError, match="is it a Modbus port"):
            client.read(3, 0, 1)
        client.close()


def test_three_silent_cycles_are_a_lost_link() -> None:
    request = "00 {:02x} 00 00 00 11 01 17 02 00 00 05 01 00 00 03 06 00 64 00 00 00 00"
    script = [(request.format(n), "") for n in (1, 2, 3)]
    with peer(script) as (port, _):
        bus = ModbusBus(
            Client(TcpWire("127.0.0.1", port), 1, 1.0),
            load_profile("virtual-modbus"),
            WallPace(0.02),
        )
        with pytest.raises(LinkLost, match="no answer for 3 cycles of 20 ms"):
            bus.exchange((100, 0))
        bus.close()


def test_nobody_there_is_said_plainly() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(LinkError, match=f"cannot connect to 127.0.0.1:{port}"):
        Client(TcpWire("127.0.0.1", port), 1, 0.5)


@pytest.mark.parametrize("function", [16, 22])
def test_bits_leave_the_rest_of_their_register_alone(function: int) -> None:
    profile = load_profile("delta-asda")
    address = profile.parameters["servo_on"].address.model_copy(
        update={"bits": 0x0004, "write_function": function}
    )
    if function == 16:  # read 00A1h, write 00A5h; then, posted, read 00B5h and write 00B1h
        script = [
            ("00 01 00 00 00 06 01 03 04 0e 00 01", "00 01 00 00 00 05 01 03 02 00 A1"),
            (
                "00 02 00 00 00 09 01 10 04 0e 00 01 02 00 a5",
                "00 02 00 00 00 06 01 10 04 0E 00 01",
            ),
            ("00 03 00 00 00 06 01 03 04 0e 00 01", "00 03 00 00 00 05 01 03 02 00 B5"),
            (
                "00 04 00 00 00 09 01 10 04 0e 00 01 02 00 b1",
                "00 04 00 00 00 06 01 10 04 0E 00 01",
            ),
        ]
    else:  # AND mask FFFBh, OR mask 0004h, then 0000h (6.16 of the standard)
        script = [
            (
                "00 01 00 00 00 08 01 16 04 0e ff fb 00 04",
                "00 01 00 00 00 08 01 16 04 0E FF FB 00 04",
            ),
            (
                "00 02 00 00 00 08 01 16 04 0e ff fb 00 00",
                "00 02 00 00 00 08 01 16 04 0E FF FB 00 00",
            ),
        ]
    with peer(script) as (port, _):
        client = Client(TcpWire("127.0.0.1", port), 1, 1.0)
        bus = ModbusBus(client, profile, WallPace(0.01))
        bus.write(address, 1)
        bus.post(address, 0)
        bus.close()


@pytest.mark.parametrize("code", range(1, 12))
def test_acknowledge_and_busy_are_not_yet_and_any_other_exception_is_no(code: int) -> None:
    """Application protocol 7: acknowledge, server busy.

    Gateway's path unavailable, its target silent.
    """
    request = "00 01 00 00 00 06 01 03 03 00 00 02"
    with peer([(request, f"00 01 00 00 00 03 01 83 {code:02X}")]) as (port, _):
        client = Client(TcpWire("127.0.0.1", port), 1, 1.0)
        with pytest.raises(AccessDenied) as caught:
            client.read(3, 0x0300, 2)
        assert caught.value.busy is (code in (5, 6, 10, 11))
        client.close()


WHO = "00 {:02X} 00 00 00 05 01 2b 0e 01 00".lower()
BUSY = "00 {:02X} 00 00 00 03 01 AB 06"


def test_a_busy_drive_is_asked_again_who_it_is() -> None:
    named = "00 02 00 00 00 0B 01 2B 0E 01 01 00 00 01 00 01 41"
    script = [(WHO.format(1), BUSY.format(1)), (WHO.format(2), named)]
    with peer(script) as (port, _):
        client = Client(TcpWire("127.0.0.1", port), 1, 1.0)
        assert identify(client, 5.0).vendor == "A"
        client.close()


def test_who_it_is_keeps_nobody_from_stopping_a_busy_drive() -> None:
    with peer([(WHO.format(1), BUSY.format(1))]) as (port, _):
        client = Client(TcpWire("127.0.0.1", port), 1, 1.0)
        assert identify(client, 0.0) == Identity(vendor="", product="", revision="", serial="")
        client.close()


CYCLE = "00 {:02x} 00 00 00 11 01 17 02 00 00 05 01 00 00 03 06 00 00 00 00 00 00"


def test_a_busy_answer_to_the_cycle_is_a_missed_one() -> None:
    answer = "00 02 00 00 00 0D 01 17 0A 12 37 00 00 00 00 00 00 00 00"
    script = [(CYCLE.format(1), "00 01 00 00 00 03 01 97 06"), (CYCLE.format(2), answer)]
    with peer(script) as (port, _):
        client = Client(TcpWire("127.0.0.1", port), 1, 1.0)
        bus = ModbusBus(client, load_profile("virtual-modbus"), WallPace(0.005))
        assert bus.exchange((0, 0)).missed == 1
        bus.close()


def test_a_refused_cycle_is_a_fault_of_the_drive() -> None:
    with peer([(CYCLE.format(1), "00 01 00 00 00 03 01 97 02")]) as (port, _):
        client = Client(TcpWire("127.0.0.1", port), 1, 1.0)
        bus = ModbusBus(client, load_profile("virtual-modbus"), WallPace(0.2))
        with pytest.raises(
            DriveFault, match=r"the drive refuses the cycle: .* exception 2"
        ) as caught:
            bus.exchange((0, 0))
        assert caught.value.exit_code == 5
        bus.close()
