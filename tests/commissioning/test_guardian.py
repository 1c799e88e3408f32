"""The guardian alone: an energised drive, and a loop that dies, falls silent, or has done."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import commissioning.guardian
from commissioning import guardian_process
from commissioning.guardian import NOBODY, Guardian, guarded
from commissioning.journal import Journal
from commissioning.processes import start
from commissioning.session.armed import noted
from drivers.drive import StopFrames, StopReport
from drivers.home import home
from drivers.link import axis_of, open_drive
from drivers.profiled import ProfiledDrive
from profiles.axis import Axis
from profiles.errors import DriveFault, LinkError, LinkLost, PreflightRefused
from profiles.schema import Mode
from tests.conftest import Serve
from tests.serving import WIRES

pytestmark = pytest.mark.skipif(os.name == "nt", reason="descriptors are inherited on POSIX")
_PATIENCE, _LOOK = 20.0, 0.02  # s for what takes a fraction of one
SILENT = "the loop was silent for more than 250 ms"


@contextlib.contextmanager
def energised(serve: Serve, wire: str, tmp_path: Path) -> Generator[tuple[ProfiledDrive, Guardian]]:
    """A drive without a watchdog that is left energised, and its guardian."""
    (link,) = serve("bench", *WIRES[wire])
    base = "virtual-canopen" if link.startswith("canopen") else "virtual-modbus"
    profile = tmp_path / "unwatched.toml"
    profile.write_text(f'extends = "{base}"\nname = "unwatched"\n[watchdog]\nkind = "none"\n')
    axis = Axis(link=link, profile=str(profile))
    drive = open_drive(axis, cycle=0.025)  # patient with a busy computer
    drive._bus.write(drive.profile.parameters["watchdog_time"].address, 0)
    try:
        with guarded(drive, axis, profile, begun(axis), home()) as guardian:
            drive.enable(Mode.TORQUE)
            drive.exchange(0.0)
            yield drive, guardian
        with contextlib.suppress(LinkError):  # answers to the guardian's frames come to us
            drive.read_raw("max_torque")
        assert drive.read_raw("max_torque") == 3000, "the way to the drive is ours, as before"
    finally:
        drive.close()


def begun(axis: Axis) -> str:
    """A run that the guardian can write to."""
    with Journal(home()) as journal:
        described: dict[str, Any] = {"axis": {}, "fraction": 0.85}
        return journal.begin(
            axis="a",
            link=str(axis.link),
            profile="p",
            profile_hash="",
            serial="",
            context=described,
        )


def comes_to_rest(drive: ProfiledDrive) -> bool:
    """Whether the drive is without energy before long."""
    until = time.monotonic() + _PATIENCE
    while time.monotonic() < until:
        with contextlib.suppress(Exception):  # answers to the guardian's frames come to us
            if not drive.is_energised():
                return True
        time.sleep(_LOOK)
    return False


def feed_for_long(guardian: Guardian) -> None:
    until = time.monotonic() + _PATIENCE
    while time.monotonic() < until:
        guardian.feed()
        time.sleep(_LOOK)


def said() -> list[str]:
    """What the guardian wrote into the journal, when it has."""
    until = time.monotonic() + _PATIENCE
    while time.monotonic() < until:
        with Journal(home()) as journal:
            events = [str(event["text"]) for event in journal.export("last")["events"]]
        if events:
            return events
        time.sleep(_LOOK)
    return []


def test_a_dead_loop_is_seen_at_once(serve: Serve, wire: str, tmp_path: Path) -> None:
    with energised(serve, wire, tmp_path) as (drive, guardian):
        assert guardian.reclaim is None, "it inherits a port, or connects"
        assert guardian._process is not None
        assert guardian._process.stdin is not None
        guardian._process.stdin.close()
        assert comes_to_rest(drive)
        assert said()[0].startswith("guardian: the loop has died; ")


@pytest.mark.parametrize("wire", ["modbus-tcp", "slcan"])  # each way to stop; the others above
def test_a_silent_loop_is_stopped_for_once_it_is_armed(
    serve: Serve, wire: str, tmp_path: Path
) -> None:
    with energised(serve, wire, tmp_path) as (drive, guardian):
        guardian.arm()
        assert comes_to_rest(drive)
        assert said()[0].startswith("guardian: the loop was silent for more than 250 ms; ")
        with pytest.raises(DriveFault, match=f"^the guardian process stopped the axis: {SILENT}$"):
            feed_for_long(guardian)
        assert noted(guardian)[0] == f"the guardian process stopped the axis: {SILENT}"
        assert noted(guardian)[1].startswith("guardian: ")


@pytest.fixture
def owner(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on Windows: a process inherits no port, so the guardian owns it."""
    monkeypatch.setattr(commissioning.guardian, "INHERITS", False)


serial = pytest.mark.parametrize("wire", ["modbus-rtu", "slcan"])


@serial
@pytest.mark.usefixtures("owner")
def test_the_loop_speaks_through_a_guardian_that_owns_the_port(
    serve: Serve, wire: str, tmp_path: Path
) -> None:
    with energised(serve, wire, tmp_path) as (drive, guardian):
        guardian.arm()
        for _ in range(20):
            sample = drive.exchange(0.05)  # less than the friction
            guardian.feed()
        assert sample.status.enabled
        assert sample.torque == pytest.approx(0.05, abs=2e-3)
        guardian.rest()
        assert drive.stop().deenergised
    assert drive._bus.port() is not None


@serial
@pytest.mark.usefixtures("owner")
def test_a_guardian_that_owns_the_port_stops_for_a_silent_loop(
    serve: Serve, wire: str, tmp_path: Path
) -> None:
    with energised(serve, wire, tmp_path) as (drive, guardian):
        guardian.arm()
        assert said()[0].startswith("guardian: the loop was silent for more than 250 ms; ")
        assert comes_to_rest(drive)  # it has ended, so the port is ours again


@serial
@pytest.mark.usefixtures("owner")
def test_the_port_of_a_guardian_that_dies_is_opened_here_and_the_axis_stopped(
    serve: Serve, wire: str, tmp_path: Path
) -> None:
    with energised(serve, wire, tmp_path) as (drive, guardian):
        guardian.arm()
        assert guardian._process is not None
        guardian._process.kill()
        guardian._process.wait()
        words = "the guardian process has ended.* through its port, which was opened here"
        with pytest.raises(DriveFault, match=words):
            feed_for_long(guardian)
        report = drive.stop()
        assert report.deenergised
        assert report.failures == ()


@serial
@pytest.mark.usefixtures("owner")
def test_a_guardian_that_hangs_keeps_nobody_from_stopping_the_axis(
    serve: Serve, wire: str, tmp_path: Path
) -> None:
    reports: list[StopReport] = []
    stops_before_close: list[int] = []
    with pytest.raises(LinkLost), energised(serve, wire, tmp_path) as (drive, guardian):  # noqa: PT012
        process, stop, close = guardian._process, drive.stop, drive.close
        assert process is not None

        def closed() -> None:
            stops_before_close.append(len(reports))
            close()

        drive.close = closed  # type: ignore[method-assign]
        drive.stop = lambda *arguments: reported(stop, reports)  # type: ignore[method-assign]
        process.send_signal(signal.SIGSTOP)
        process.wait = impatient(process.wait)  # type: ignore[method-assign]
        for _ in range(20):
            drive.exchange(0.05)
    assert stops_before_close == [1]
    assert reports[0].deenergised, "once its port was ours again"


def reported(stop: Callable[[], StopReport], reports: list[StopReport]) -> StopReport:
    reports.append(stop())
    return reports[-1]


@pytest.mark.usefixtures("owner")
def test_a_port_that_the_guardian_cannot_open_is_the_loop_s_again(
    serve: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(*arguments: object) -> None:
        raise RuntimeError("no process today")

    monkeypatch.setattr(commissioning.guardian, "_process", none)
    with (
        pytest.raises(PreflightRefused, match="no guardian process can be started"),
        energised(serve, "modbus-rtu", tmp_path),
    ):
        pass


def test_words_that_a_pipe_would_make_wait_for_go_by_a_thread() -> None:
    """As on Windows before Python 3.12."""
    reader, writer = os.pipe()
    line = commissioning.guardian._Background(writer)
    line.write(b"a")
    assert os.read(reader, 1) == b"a"
    other = commissioning.guardian._Background(writer)
    other.write(b"q")
    other.end()
    assert os.read(reader, 1) == b"q", "it had left when that returned"
    os.close(reader)
    with pytest.raises(BrokenPipeError):
        put_for_long(line)
    os.close(writer)


def test_the_last_word_has_left_when_the_line_ends() -> None:
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writer, b"." * 4096)
    os.set_blocking(writer, True)
    line = commissioning.guardian._Background(writer)
    line.write(b"q")
    drain = threading.Timer(0.1, os.read, (reader, 1 << 20))
    drain.start()
    line.end()
    assert not line._thread.is_alive()
    drain.join()
    os.close(reader)
    os.close(writer)


def test_a_guardian_is_told_what_it_needs_and_how_long_silence_may_be(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    orders: list[dict[str, Any]] = []

    def noted_order(order: dict[str, Any], descriptors: tuple[int, ...] = ()) -> tuple[None, str]:
        orders.append(order | {"descriptors": descriptors})
        return None, ""

    monkeypatch.setattr(commissioning.guardian, "_process", noted_order)
    frames = StopFrames(7, ((b"\x01\x02", 0.03),), None)
    for cycle, limit in ((0.001, 0.25), (0.025, 0.25), (0.05, 0.5)):
        drive = SimpleNamespace(
            in_real_time=True, cycle=cycle, link="modbus-rtu:///dev/x", stop_frames=lambda: frames
        )
        axis = Axis(name="a", profile="other", link="virtual://bench")
        with guarded(drive, axis, tmp_path / "p.toml", "run", tmp_path):  # type: ignore[arg-type]
            order = orders[-1]
        assert order["limit"] == pytest.approx(limit)
        assert (order["run"], order["home"]) == ("run", str(tmp_path))
        assert (order["descriptor"], order["descriptors"]) == (7, (7,))
        assert order["frames"] == [("0102", 0.03)]
        assert order["axis"]["link"] == "modbus-rtu:///dev/x"
        assert order["axis"]["profile"] == str(tmp_path / "p.toml")


def put_for_long(line: commissioning.guardian._Background) -> None:
    until = time.monotonic() + _PATIENCE
    while time.monotonic() < until:
        line.write(b".")


def test_a_loop_that_rests_may_be_silent(serve: Serve, tmp_path: Path) -> None:
    with energised(serve, "modbus-tcp", tmp_path) as (drive, guardian):
        guardian.arm()
        guardian.rest()
        time.sleep(0.6)  # more than twice the silence that is a failure
        assert drive.is_energised()
        drive.stop()
    with Journal(home()) as journal:
        assert journal.export("last")["events"] == []


# -- the loop's end of the line, with processes that are none ---------------------------------------------


def pretending(monkeypatch: pytest.MonkeyPatch, code: str) -> None:
    """Instead of the guardian, a process that does this after it has heard its order."""

    def start(module: str, **streams: Any) -> subprocess.Popen[bytes]:
        assert module == "commissioning.guardian_process"
        return subprocess.Popen([sys.executable, "-c", f"input(); {code}"], **streams)

    monkeypatch.setattr(commissioning.guardian, "start", start)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("print('no such profile')", "^no such profile$"),
        ("print('readyish')", "^readyish$"),
        ("pass", "^it does not answer$"),
        ("import time; time.sleep(60)", "^it does not answer$"),
    ],
)
def test_a_guardian_that_does_not_say_it_is_ready_is_none(
    monkeypatch: pytest.MonkeyPatch, code: str, words: str
) -> None:
    pretending(monkeypatch, code)
    monkeypatch.setattr(commissioning.guardian, "_READY", 0.5)
    with pytest.raises(RuntimeError, match=words):
        commissioning.guardian._process({"an": "order"})


def test_what_a_guardian_says_beside_that_it_is_ready_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pretending(monkeypatch, "print('ready 4711', flush=True); input()")
    process, place = commissioning.guardian._process({})
    assert place == "4711"
    Guardian(process).dismiss()
    assert process.poll() is not None


def test_a_guardian_that_reads_nothing_does_not_make_the_loop_wait(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pretending(monkeypatch, "print('ready', flush=True); import time; time.sleep(60)")
    process, _ = commissioning.guardian._process({})
    guardian = Guardian(process)
    for _ in range(200_000):  # a pipe holds 65 536
        guardian.feed()
    monkeypatch.setattr(process, "wait", impatient(process.wait))
    guardian.dismiss()
    assert process.returncode is not None, "it was killed"
    guardian.dismiss()
    guardian.feed()


def impatient(wait: Callable[..., int]) -> Callable[..., int]:
    def waits(seconds: float | None = None) -> int:
        if seconds is not None:
            raise subprocess.TimeoutExpired("guardian", seconds)
        return wait()

    return waits


class Broken:
    """A line on which nobody listens."""

    def write(self, word: bytes) -> None:
        raise BrokenPipeError

    def end(self) -> None:
        return


def test_a_dead_guardian_is_told_once_with_what_became_of_its_port() -> None:
    def gone() -> None:
        raise OSError("no such device")

    for reclaim, words in (
        (None, "the axis was stopped$"),
        (lambda: None, "stopped through its port, which was opened here$"),
        (gone, r"the guardian's port cannot be opened here \(no such device\)$"),
    ):
        guardian = Guardian()
        guardian.reclaim = reclaim
        guardian._line = Broken()
        with pytest.raises(DriveFault, match=words):
            guardian.feed()
        guardian.feed()


def test_a_guardian_that_died_while_nothing_moved_lets_nothing_move_any_more() -> None:
    guardian = Guardian()
    guardian._line = Broken()
    guardian.rest()  # says nothing: a stop may be under way
    with pytest.raises(DriveFault, match="it is not moved"):
        guardian.arm()


def test_a_guardian_that_stopped_the_axis_is_not_one_that_ended(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Also where its last words come after its death has been seen."""
    pretending(
        monkeypatch,
        "print('ready', flush=True); import sys, time; sys.stdin.close(); time.sleep(0.2); "
        "print('silent'); print('at rest')",
    )
    guardian = Guardian(commissioning.guardian._process({})[0])
    assert guardian.acted() == ""
    guardian._line = Broken()
    with pytest.raises(DriveFault, match="the guardian process has ended"):
        guardian.feed()  # nothing is waited for before the axis is stopped
    assert noted(guardian) == [
        "the guardian process stopped the axis: silent", "guardian: at rest",
    ]  # fmt: skip
    guardian.dismiss()


@pytest.mark.parametrize("word", ["arm", "feed"])
def test_no_command_goes_out_beside_the_stop_of_a_guardian(word: str) -> None:
    """It said why before it stopped the drive; a loop that comes back would enable it again."""
    guardian = Guardian()
    getattr(guardian, word)()
    guardian.said.append("silent")
    with pytest.raises(DriveFault, match=r"^the guardian process stopped the axis: silent$"):
        getattr(guardian, word)()
    guardian.rest()


def test_a_guardian_that_does_nothing_leaves_no_note() -> None:
    assert noted(NOBODY) == noted(Guardian()) == []


@pytest.mark.parametrize("watchdog", ["none", "cycle"])
def test_without_a_guardian_nothing_moves_in_real_time(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, watchdog: str
) -> None:
    """The drive's own watchdog is no substitute."""
    pretending(monkeypatch, "print('cannot be reached')")
    kind = SimpleNamespace(watchdog=SimpleNamespace(kind=watchdog))
    drive = SimpleNamespace(
        in_real_time=True, cycle=0.004, link="virtual://bench", profile=kind,
        stop_frames=lambda: None,
    )  # fmt: skip
    axis = Axis(name="a", profile="other", link="virtual://bench")
    with (
        pytest.raises(PreflightRefused, match=r"without one nothing would .*: cannot be reached$"),
        guarded(drive, axis, tmp_path / "p.toml", "run", tmp_path),  # type: ignore[arg-type]
    ):
        pass


def test_nobody_is_told_nothing() -> None:
    for word in (NOBODY.arm, NOBODY.feed, NOBODY.rest, NOBODY.dismiss):
        word()


def test_stepped_drives_have_no_guardian(tmp_path: Path) -> None:
    drive = open_drive(axis_of("virtual://bench"))
    with guarded(drive, axis_of("virtual://bench"), tmp_path, "x", tmp_path) as guardian:
        assert guardian is NOBODY
    drive.close()


# -- the guardian's own process ---------------------------------------------------------------------------


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
    waiting._drive = SimpleNamespace(other_master=other_master)  # type: ignore[assignment]
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
        ({"axis": {"link": "modbus-tcp://127.0.0.1:1", "profile": "virtual-modbus"}}, "cannot connect", 4),
        ({"axis": {"link": "modbus-tcp://127.0.0.1:1", "profile": "nosuch"}}, "no profile named", 2),
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
