"""A serial port, and one that is lent.

What the borrower hears, and what is left when its owner ends.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.serial_port import LentPort, SerialPort

pytestmark = pytest.mark.skipif(os.name == "nt", reason="needs pseudo-terminals")


@pytest.fixture
def line() -> Iterator[tuple[int, SerialPort]]:
    """The far end of a line, and the port at its near end."""
    import tty

    far, near = os.openpty()
    tty.setraw(near)
    yield far, SerialPort(os.ttyname(near), 9600, timeout=0.05)
    os.close(far)
    os.close(near)


@pytest.fixture
def lent(line: tuple[int, SerialPort]) -> Iterator[tuple[LentPort, socket.socket, int]]:
    """A port that is lent, its owner's end of the link, and the far end of the line."""
    ours, owner = socket.socketpair()
    port = LentPort(ours, line[1])
    yield port, owner, line[0]
    port.close()
    ours.close()
    owner.close()


Lent = tuple[LentPort, socket.socket, int]


def test_a_port_that_is_not_there_or_is_none_is_an_error_of_the_system(tmp_path: Path) -> None:
    for device, words in ((str(tmp_path / "nosuch"), "No such file"), (os.devnull, "ioctl")):
        with pytest.raises(OSError, match=words):
            SerialPort(device, 9600).open()


def test_a_port_has_one_owner_and_the_next_waits_for_it(
    line: tuple[int, SerialPort], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, port = line
    first = port.open()
    with pytest.raises(OSError, match="lock"):
        port.open()
    pauses: list[float] = []

    def pause(seconds: float) -> None:
        pauses.append(seconds)
        if len(pauses) == 3:
            first.close()

    monkeypatch.setattr("drivers.serial_port.time.sleep", pause)
    second = port.open_when_free()
    assert pauses == [0.02] * 3
    pauses.clear()
    with pytest.raises(OSError, match="lock"):
        port.open_when_free(1.0)
    assert len(pauses) == 50, "as long as it was said to wait, then the reason"
    second.close()


def test_what_the_owner_passes_on_is_read_as_from_a_port(lent: Lent) -> None:
    port, owner, _ = lent
    assert port.in_waiting == 0
    assert port.read(1) == b"", "its time-out has passed"
    owner.sendall(b"abcdef")
    assert port.in_waiting == 6
    assert (port.read(2), port.read(2), port.in_waiting) == (b"ab", b"cd", 2)
    assert port.read(5) == b"ef", "what there is when the time is over"
    owner.sendall(b"old")
    port.reset_input_buffer()
    assert port.in_waiting == 0
    port.timeout = 0.0
    assert port.read(1) == b""


def test_what_is_written_goes_to_the_owner(lent: Lent) -> None:
    port, owner, _ = lent
    assert port.write(b"question") == 8
    port.flush()
    assert owner.recv(100) == b"question"
    assert port.fileno() == port._link.fileno()


def test_a_reader_finds_that_the_owner_is_gone_and_opens_the_port(lent: Lent) -> None:
    port, owner, far = lent
    owner.close()
    assert port.read(1) == b""
    os.write(far, b"here")
    assert port.read(4) == b"here"
    assert port._own is not None
    assert port.fileno() == port._own.fileno()
    os.write(far, b"x")
    while not port.in_waiting:
        pass


def test_a_port_that_could_not_be_reclaimed_is_tried_again_at_the_next_word(lent: Lent) -> None:
    port, owner, far = lent
    owner.close()
    held = port._port.open()
    port._patience = 0.0
    for word in (lambda: port.read(1), lambda: port.in_waiting, lambda: port.write(b"x")):
        with pytest.raises(OSError, match="lock"):
            word()
    held.close()
    assert port.write(b"stop") == 4
    assert os.read(far, 100) == b"stop"


def test_a_writer_finds_it_too_and_loses_nothing(lent: Lent) -> None:
    port, owner, far = lent
    owner.close()
    assert port.write(b"stop") == 4
    port.flush()
    assert os.read(far, 100) == b"stop"


def test_a_port_is_reclaimed_once(lent: Lent) -> None:
    port, _, far = lent
    port.reclaim()
    own = port._own
    port.reclaim()
    assert port._own is own
    port.write(b"ours")
    assert os.read(far, 100) == b"ours"


def test_without_a_time_out_a_read_waits_for_what_it_wants(lent: Lent) -> None:
    port, owner, _ = lent
    port.timeout = None
    owner.sendall(b"ab")
    assert port.read(2) == b"ab"
