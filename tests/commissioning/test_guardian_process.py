"""The guardian's own process: what it waits for, and how it stops the drive."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import select
import socket
import subprocess
import threading
import time
from types import SimpleNamespace
from typing import Any

import pytest

from commissioning import guardian_process
from commissioning.processes import start
from drivers.drive import StopReport
from drivers.errors import LinkLost
from profiles.axis import Axis

pytestmark = pytest.mark.skipif(os.name == "nt", reason="descriptors are inherited on POSIX")
_PATIENCE, _LOOK = 20.0, 0.02  # s


class Idle:
    """What must be stopped, and never is."""

    idled = 0

    def idle(self) -> None:
        self.idled += 1


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ([b"a", b".", b"q"], ""),
        ([b"a..q"], ""),
        ([b"a", b"."], "the loop was silent for more than 100 ms"),
        ([b"ra"], "the loop was silent for more than 100 ms"),
        ([b"r", b"a"], "the loop was silent for more than 100 ms"),
        ([b"a", b"r", None, b"q"], ""),
        ([b"ar", None, b"q"], ""),
        ([b".", None, b"q"], ""),
        ([None, b"q"], ""),
        ([b"a", b"r", b""], "the loop has died"),
        ([b""], "the loop has died"),
    ],
)
def test_silence_counts_from_the_last_word_while_armed(
    monkeypatch: pytest.MonkeyPatch, words: list[bytes | None], why: str
) -> None:
    """None: silence for three times as long as is allowed."""

    def speak(line: queue.Queue[bytes]) -> None:
        for word in words:
            if word is None:
                time.sleep(0.3)
            else:
                line.put(word)

    monkeypatch.setattr(guardian_process, "_listen", speak)
    stop = Idle()
    assert guardian_process._watch(0.1, stop) == why  # type: ignore[arg-type]
    assert bool(stop.idled) is (None in words or "silent" in why)


def test_what_others_say_does_not_pile_up_while_the_guardian_waits() -> None:
    asked = []

    def other_master() -> str:
        asked.append(True)
        raise LinkLost("cable")

    waiting = guardian_process._ByConnection.__new__(guardian_process._ByConnection)
    waiting._drive = SimpleNamespace(line=SimpleNamespace(other_master=other_master))  # type: ignore[assignment]
    waiting.idle()
    assert asked == [True]


def test_every_word_is_heard_and_the_end_of_the_line() -> None:
    reader, writer = os.pipe()
    words: queue.Queue[bytes] = queue.Queue()
    thread = threading.Thread(target=guardian_process._listen, args=(words, reader))
    thread.start()
    for word in (b"a", b".", b"q"):
        os.write(writer, word)
        assert words.get(timeout=_PATIENCE) == word
    os.close(writer)
    assert words.get(timeout=_PATIENCE) == b""
    thread.join(_PATIENCE)
    assert not thread.is_alive()
    os.close(reader)


def test_a_first_connection_that_died_is_not_the_last_try(monkeypatch: pytest.MonkeyPatch) -> None:
    class Connection:
        def __init__(self, deenergised: bool | None) -> None:
            self.deenergised, self.stops = deenergised, 0

        def stop(self) -> StopReport:
            self.stops += 1
            return StopReport(self.deenergised)

    def by(*connections: Connection) -> str:
        left = list(connections)
        monkeypatch.setattr(guardian_process._ByConnection, "_connected", lambda self: left.pop(0))
        return guardian_process._ByConnection(Axis(name="a")).now()

    dead, fresh = Connection(None), Connection(True)
    assert by(dead, fresh) == "axis stopped and de-energised"
    assert (dead.stops, fresh.stops) == (1, 1)
    good, unused = Connection(True), Connection(True)
    by(good, unused)
    assert (good.stops, unused.stops) == (1, 0)
    stuck, unused = Connection(False), Connection(True)
    assert "STILL ENERGISED" in by(stuck, unused)
    assert unused.stops == 0

    def gone(self: object) -> Connection:
        raise LinkLost("cable")

    lost = guardian_process._ByConnection.__new__(guardian_process._ByConnection)
    lost._drive = Connection(None)  # type: ignore[assignment]
    monkeypatch.setattr(guardian_process._ByConnection, "_connected", gone)
    assert "NOT verified" in lost.now()


@pytest.mark.parametrize(
    ("order", "words", "code"),
    [
        ({"axis": {"link": "modbus-tcp://127.0.0.1:1", "profile": "virtual-modbus"}},
        "cannot connect", 4),
        ({"axis": {"link": "modbus-tcp://127.0.0.1:1", "profile": "nosuch"}}, "no profile named",
        2),
        ({"port": ["/dev/nosuch", 9600, "N", 1], "token": "x"}, "nosuch", 4),
    ],
)  # fmt: skip
def test_a_guardian_that_cannot_reach_the_drive_says_why_and_ends(
    monkeypatch: pytest.MonkeyPatch, order: dict[str, Any], words: str, code: int
) -> None:
    process = start("commissioning.guardian_process", stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    said_, _ = process.communicate(
        json.dumps({"frames": [], "limit": 1.0, **order}).encode() + b"\n"
    )
    assert words in said_.decode()
    assert process.returncode == code


def test_a_port_is_lent_to_whoever_knows_the_token_and_to_nobody_after() -> None:
    import tty

    far, near = os.openpty()
    tty.setraw(near)
    owner = guardian_process._AsOwner([os.ttyname(near), 9600, "N", 1], "secret")
    assert owner.place > 1023, "any free port"
    try:
        with socket.create_connection(("127.0.0.1", owner.place)) as stranger:
            stranger.sendall(b"wrong!")
            assert stranger.recv(1) == b"", "hung up on"
        with socket.create_connection(("127.0.0.1", owner.place)) as loop:
            loop.sendall(b"secretquestion")
            assert read_all(far, 8) == b"question"
            os.write(far, b"answer")
            assert loop.recv(6, socket.MSG_WAITALL) == b"answer"
            with pytest.raises(ConnectionError):
                socket.create_connection(("127.0.0.1", owner.place)).close()
            owner.write(b"stop")
            assert read_all(far, 4) == b"stop"
            loop.sendall(b"go on")
            assert loop.recv(1) == b"", "what the loop says goes nowhere any more"
            assert not select.select([far], [], [], 0.2)[0]
    finally:
        owner.close()
        os.close(far)
        os.close(near)


def test_frames_are_written_although_the_loop_has_told_its_port_not_to_wait() -> None:
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writer, b"." * 4096)
    drain = threading.Timer(0.1, read_all, (reader, 1 << 16))
    drain.start()
    assert guardian_process._to_descriptor(writer)(b"stop") == 4
    drain.join()
    assert read_all(reader, 4) == b"stop"
    os.close(reader)
    os.close(writer)


def test_frames_are_written_with_their_pauses_and_then_the_port_is_free(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    done: list[object] = []

    def write(frame: bytes) -> None:
        done.append(frame)
        if frame == b"2":
            raise OSError("unplugged")

    monkeypatch.setattr("commissioning.guardian_process.time.sleep", done.append)
    frames = [(b"1", 0.03), (b"2", 0.5), (b"3", 0.03)]
    said_ = guardian_process._ByFrames(write, frames, lambda: done.append("free")).now()
    assert done == [b"1", 0.03, b"2", 0.5, b"3", 0.03, "free"]
    assert said_ == "stop frames sent; not verified"


def test_a_guardian_that_owns_a_port_ends_also_where_nobody_came_for_it() -> None:
    import tty

    far, near = os.openpty()
    tty.setraw(near)
    process = start("commissioning.guardian_process", stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    order = {"frames": [], "limit": 1.0, "port": [os.ttyname(near), 9600, "N", 1], "token": "x"}
    process.stdin.write(json.dumps(order).encode() + b"\n")
    process.stdin.flush()
    assert process.stdout.readline().startswith(b"ready ")
    said_, _ = process.communicate(b"q", timeout=_PATIENCE)
    assert (process.returncode, said_) == (0, b"")
    os.close(far)
    os.close(near)


def read_all(descriptor: int, count: int) -> bytes:
    found = b""
    while len(found) < count:
        found += os.read(descriptor, count - len(found))
    return found
