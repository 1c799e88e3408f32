"""Bad input of every kind: its exit code, one plain line, the axis at rest, nothing lost."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.drive import Drive
from drivers.link import axis_of, open_drive
from profiles.library import source_text
from profiles.procedures import Mode
from tests.command import running
from tests.conftest import Serve, Tworelay
from tests.interrupting import signalled
from tests.punctual import real_time
from tests.serving import WIRES

posix = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
TRAVEL = ("--travel", "3", "--yes")
# so many periods that there is time to break in, whatever else this computer does
LONG = ("--travel", "20", "--yes", "--cycle", "0.004", "--method", "two-relay", "--repeat", "50")
TOLD = (*LONG, "-v")


def one_line(done: subprocess.CompletedProcess[str], code: int, words: str) -> None:
    assert done.returncode == code, (done.stdout, done.stderr)
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    assert words in done.stderr
    assert "Traceback" not in done.stderr


def opened(link: str) -> Drive:
    return open_drive(axis_of(link))


def assert_safe_and_complete(link: str) -> None:
    """The axis is at rest and de-energised, and every parameter is as delivered."""
    drive = opened(link)
    assert not drive.state().is_energised
    before = drive.read("position_actual").raw
    drive.wait(0.05)
    assert drive.read("position_actual").raw == before
    assert drive.read("max_torque").raw == 3000
    assert drive.read("abort_connection_option").raw == 1
    assert drive.read("coulomb_positive").raw == 0
    drive.close()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["identify", "virtual://bench", "--profile", "nosuch"], "no profile named 'nosuch'"),
        (["identify", "virtual://nosuch"], "no virtual axis named 'nosuch'"),
        (
            ["identify", "virtual://bench?friction=1"],
            "no option of a virtual axis named 'friction'",
        ),
        (["identify", "nosuch"], "no link and no axis file"),
        (["identify", "modbus-tpc://10.0.0.1"], "did you mean modbus-tcp://?"),
        (["identify", "nosuch.toml"], "cannot be read"),
        (["identify", "virtual://bench", "--travel", "abc"], "'abc' is no number with a unit"),
        (["identify", "virtual://bench", "--travel", "-1"], "not in the range 0<x"),
        (["identify", "virtual://bench", "--fraction", "2"], "0<=x<=1"),
        (["identify", "virtual://bench", "--no-such-option"], "No such option"),
        (["identify"], "Missing argument"),
        (["frobnicate"], "No such command"),
        (["report", "nosuch"], "no run named 'nosuch'"),
        (["profile", "check", "nosuch.toml"], "cannot be read"),
        (["identify", "virtual://bench", "--cycle", "nan"], "is no number with a unit"),
        (["identify", "virtual://bench", "--max-torque", "inf"], "is no number with a unit"),
        (["identify", "virtual://bench", "--json", "/no/such/folder/x"], "cannot be written"),
        (["identify", "virtual://bench", "--trace", "x"], "has no frames"),
        (["identify", "virtual://bench?encoder=1e12"], "must be 16…"),
        (["identify", "virtual://bench?cycle=1e12"], "must be 1e-05…1"),
        (["identify", "modbus-tcp://[::1"], "is no link"),
        (["identify", "modbus-tcp://h?unit=²"], "only ASCII"),
        (["identify", "x" * 300], "no link and no axis file"),
        (["virtual", "serve", "bench"], "serve where?"),
        (["virtual", "serve", "bench", "--modbus-tcp", "x"], "must be HOST:PORT"),
    ],
)
def test_usage(tworelay: Tworelay, arguments: list[str], words: str) -> None:
    one_line(tworelay(*arguments), 2, words)


def test_an_unknown_key_in_a_profile(tworelay: Tworelay, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(source_text("virtual-modbus").replace("[watchdog]", "[watchdog]\ntimout = 1.0"))
    done = tworelay("identify", "virtual://bench", "--profile", str(path), *TRAVEL)
    one_line(done, 2, "[watchdog] timout: unknown key, did you mean 'timeout'?")


def test_the_wrong_identity(tworelay: Tworelay, serve: Serve, tmp_path: Path) -> None:
    path = tmp_path / "acme.toml"
    path.write_text(source_text("virtual-modbus").replace('vendor = "tworelay"', 'vendor = "ACME"'))
    link = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]
    done = tworelay("identify", link, "--profile", str(path), *TRAVEL)
    one_line(done, 3, "profile 'virtual-modbus' is for vendor ACME")
    assert_safe_and_complete(link)


def test_another_drive_than_in_the_run(tworelay: Tworelay, serve: Serve) -> None:
    link = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]
    other = serve("bench", *WIRES["modbus-tcp"], "--clock", "step", "--set", "coulomb=0.2")[0]
    assert tworelay("identify", link, *TRAVEL).returncode == 0
    done = tworelay("apply", "last", "--link", other, "--yes")
    one_line(done, 3, "its values belong to another axis; nothing was written")
    assert_safe_and_complete(other)


def test_an_unreachable_host(tworelay: Tworelay) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    modbus = tworelay("identify", f"modbus-tcp://127.0.0.1:{port}", *TRAVEL)
    one_line(modbus, 4, f"cannot connect to 127.0.0.1:{port}")
    can = tworelay("identify", f"canopen://socketcand/127.0.0.1:{port}/can0?node=5", *TRAVEL)
    one_line(can, 4, "cannot connect to socketcand")
    serial = tworelay("identify", "canopen://slcan/%2Fdev%2Fnosuch?node=5", *TRAVEL)
    one_line(serial, 4, "cannot open CAN channel '/dev/nosuch'")


@pytest.fixture
def babbler() -> Iterator[int]:
    """A server that greets in a language of its own, and echoes."""
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(0.2)
    end = threading.Event()

    def talk() -> None:
        while not end.is_set():
            try:
                connection, _ = listener.accept()
            except TimeoutError:
                continue
            with connection:
                connection.settimeout(0.2)
                connection.sendall(b"SSH-2.0-babbler\r\n")
                while not end.is_set():
                    try:
                        data = connection.recv(100)
                    except TimeoutError:
                        continue
                    except OSError:
                        break
                    if not data:
                        break
                    connection.sendall(b"what? " * 5)

    thread = threading.Thread(target=talk)
    thread.start()
    yield listener.getsockname()[1]
    end.set()
    thread.join()
    listener.close()


def test_a_port_that_speaks_something_else(tworelay: Tworelay, babbler: int) -> None:
    modbus = tworelay("identify", f"modbus-tcp://127.0.0.1:{babbler}?timeout=0.3", *TRAVEL)
    one_line(modbus, 4, "is it a Modbus port")
    can = tworelay("identify", f"canopen://socketcand/127.0.0.1:{babbler}/can0?node=5", *TRAVEL)
    one_line(can, 4, "is no socketcand server")


def test_a_node_that_does_not_answer(tworelay: Tworelay, serve: Serve) -> None:
    link = serve("bench", *WIRES["socketcand"])[0]
    done = tworelay("identify", link.replace("node=5", "node=9"), *TRAVEL)
    one_line(done, 4, "node 9 does not answer")


def test_a_drive_in_fault(tworelay: Tworelay, serve: Serve) -> None:
    link = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]
    drive = opened(link)
    drive.enable(Mode.TORQUE)
    drive.exchange(0.0)
    drive.wait(0.3)  # the watchdog as delivered ends in a fault
    assert drive.state().in_fault
    drive.close()
    done = tworelay("identify", link, *TRAVEL)
    one_line(done, 3, "the drive is in fault: fault, error code 8100h")


def test_an_axis_that_somebody_else_moves(tworelay: Tworelay, serve: Serve) -> None:
    link = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]
    drive = opened(link)
    drive.enable(Mode.TORQUE)
    one_line(tworelay("identify", link, *TRAVEL), 3, "already enabled")
    done = tworelay("stop", link)
    assert done.returncode == 0
    assert "de-energised" in done.stdout
    assert not drive.state().is_energised
    drive.close()


@pytest.mark.parametrize(
    ("axis", "options", "code", "words"),
    [
        ("bench?coulomb=1.5", [], 6, "no motion up to 1 N.m"),
        ("bench", ["--travel", "0.001"], 3, "too small"),
        ("bench", ["--max-torque", "9"], 3, "above the drive's own limit"),
        ("bench", ["--duration", "2"], 5, "duration"),
        ("bench", ["--cycle", "0.05"], 3, "too slow for the drive's watchdog"),
    ],
)
def test_what_the_axis_cannot_do(
    tworelay: Tworelay, tmp_path: Path, axis: str, options: list[str], code: int, words: str
) -> None:
    target = tmp_path / "result.json"
    done = tworelay("identify", f"virtual://{axis}", "--yes", "--json", str(target), *options)
    one_line(done, code, words)
    result = json.loads(target.read_text())
    assert result["status"] in ("rejected", "refused", "stopped")
    assert all(result["friction"][key]["value"] is None for key in ("coulomb", "offset", "inertia"))


def test_no_terminal_and_no_yes(tworelay: Tworelay) -> None:
    one_line(tworelay("identify", "virtual://bench"), 3, "give --yes")


def test_a_dry_run_writes_and_moves_nothing(tworelay: Tworelay, serve: Serve) -> None:
    link = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]
    done = tworelay("identify", link, "--travel", "3", "--dry-run")
    assert done.returncode == 0
    for said in (
        "compare with the drive's own display: position 0 rad (0 of register 0202h, 0.0000 motor",
        "compare: torque limit 3 N.m (3000 of register 0310h)",
        "would set max_torque (register 0310h): 3000 → 1000 (x 0.001 rated)",
        "would set mode_of_operation (register 0111h) to 10",
        "would command torque_target (register 0100h) in every cycle, 0 first, within ±1000",
        "would enable: 6 to controlword (register 0110h), 7 to controlword",
        "would stop: 2 to controlword (register 0110h)",
    ):
        assert said in done.stdout
    assert_safe_and_complete(link)
    assert tworelay("report", "last").returncode == 2, "and it is no run"


def test_a_dry_run_shows_keys_and_pdo_mapping(
    tworelay: Tworelay, serve: Serve, tmp_path: Path
) -> None:
    twin = ("--profile", "leadshine-el7", "--modbus-rtu-tcp", "127.0.0.1:0", "--clock", "step")
    axis = tmp_path / "axis.toml"
    link = serve("bench", *twin)[0]
    axis.write_text(
        f'link = "{link}"\nprofile = "leadshine-el7"\ntravel = 3.0\nrated_torque = 1.0\n'
        "encoder = 131072\n"
    )
    done = tworelay("identify", str(axis), "--dry-run", "--without-watchdog", "--max-speed", "20")
    assert done.returncode == 0, done.stderr
    assert "would enable: 83h to input_1_function (register 0401h)" in done.stdout
    assert "would stop: 40h to position_control (register 6002h)" in done.stdout
    link = serve("bench", *WIRES["socketcand"], "--clock", "step")[0]
    done = tworelay("identify", link, "--travel", "3", "--dry-run")
    assert done.returncode == 0, done.stderr
    assert "(of the bus): 0h → 60710010h, and put it back" in done.stdout


def test_real_adapters_are_refused_in_ci_before_they_are_touched(
    tworelay: Tworelay, serve: Serve
) -> None:
    for real in ("modbus-tcp://192.0.2.1", "canopen://socketcan/can0?node=5"):
        for command in (["identify", real, *TRAVEL], ["stop", real]):
            refused = tworelay(*command, environment={"CI": "true"})
            one_line(refused, 3, "CI is set and")
    link = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]
    done = tworelay("identify", link, *TRAVEL, environment={"CI": "true"})
    assert done.returncode == 0, "loopback is no machine"


def test_a_journal_that_cannot_be_written(tworelay: Tworelay, serve: Serve, tmp_path: Path) -> None:
    blocked = tmp_path / "blocked"
    blocked.write_text("a file where the folder should be")
    link = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]
    done = tworelay("identify", link, *TRAVEL, environment={"TWORELAY_HOME": str(blocked / "home")})
    one_line(done, 7, "the journal in")
    assert_safe_and_complete(link)


def wait_for(process: subprocess.Popen[str], words: str) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        if words in line:
            return
    pytest.fail(f"'{words}' never came: {process.stderr.read() if process.stderr else ''}")


SIGNALS = [(signal.SIGINT, 130), (signal.SIGTERM, 143)]


@real_time
@posix
def test_ctrl_c_in_mid_test(serve: Serve) -> None:
    link = serve("bench", *WIRES["modbus-tcp"])[0]
    with running("identify", link, *TOLD) as process:
        wait_for(process, "short pushes")
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=30)
    assert process.returncode == 130
    assert errors.strip().splitlines() == ["tworelay: interrupted by SIGINT"]
    assert_safe_and_complete(link)


@posix
@pytest.mark.parametrize(("number", "code"), SIGNALS)
@pytest.mark.parametrize("cycles", [0, 30, 300])
def test_a_signal_in_some_cycle_ends_the_job_in_order(
    tworelay: Tworelay, serve: Serve, wire: str, number: signal.Signals, code: int, cycles: int
) -> None:
    link = serve("bench", *WIRES[wire], "--clock", "step")[0]
    with signalled(number, cycles):
        done = tworelay("identify", link, *TOLD)
    one_line(done, code, f"interrupted by {number.name}")
    assert_safe_and_complete(link)


class Cable:
    """A TCP cable between the client and a served drive, that can be cut."""

    def __init__(self, port: int) -> None:
        self._target = port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._ends: list[socket.socket] = []
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()

    def _accept(self) -> None:
        try:
            while True:
                client, _ = self._listener.accept()
                drive = socket.create_connection(("127.0.0.1", self._target))
                for end in (client, drive):
                    end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._ends += [client, drive]
                for source, sink in ((client, drive), (drive, client)):
                    thread = threading.Thread(target=self._pass, args=(source, sink))
                    self._threads.append(thread)
                    thread.start()
        except OSError:
            return

    @staticmethod
    def _pass(source: socket.socket, sink: socket.socket) -> None:
        try:
            while data := source.recv(4096):
                sink.sendall(data)
        except OSError:
            return

    def cut(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for end in self._ends:
            try:
                end.shutdown(socket.SHUT_RDWR)
            except OSError:
                continue

    def close(self) -> None:
        for thread in self._threads:
            thread.join()
        for end in self._ends:
            end.close()


def test_the_link_is_cut_in_mid_test(tworelay: Tworelay, serve: Serve) -> None:
    link = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]
    port = int(link.split(":")[2].split("?")[0])
    cable = Cable(port)
    through = link.replace(str(port), str(cable.port))
    with running("identify", through, *TOLD) as process:
        wait_for(process, "staging")
        cable.cut()
        _, errors = process.communicate(timeout=30)
    cable.close()
    assert process.returncode == 4, errors
    assert len(errors.strip().splitlines()) == 1
    assert "use the emergency stop" in errors, "it is not verified that the axis is at rest"
    assert "max_torque" in errors, "what is not put back is named"
    stopped_by_its_watchdog(link)
    drive = opened(link)
    assert drive.read("max_torque").raw == 1000
    drive.close()
    refused = tworelay("identify", link, *TRAVEL)
    one_line(refused, 3, "was cut off and left settings changed")
    restored = tworelay("restore", "--yes", "--link", link)
    assert restored.returncode == 0, restored.stderr
    assert_safe_and_complete(link)


@posix
def test_a_run_killed_with_a_profile_of_its_own_can_be_restored(
    tworelay: Tworelay, serve: Serve, tmp_path: Path
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        source_text("virtual-modbus").replace('name = "virtual-modbus"', 'name = "mine"')
    )
    link = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]
    with running("identify", link, *TOLD, "--profile", str(path)) as process:
        wait_for(process, "staging")
        process.kill()
        process.wait(10)
    path.unlink()
    blocked = tworelay("identify", link, *TRAVEL)
    one_line(blocked, 3, "was cut off and left settings changed")
    drive = opened(link)
    drive.stop()  # the clock stands still, so no watchdog did it
    drive.close()
    restored = tworelay("restore", "--yes")
    assert restored.returncode == 0, restored.stderr
    assert_safe_and_complete(link)


@posix
def test_a_drive_has_one_owner_and_a_dead_one_is_none(
    tworelay: Tworelay, serve: Serve, tmp_path: Path
) -> None:
    link = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]
    with running("identify", link, *TOLD) as process:
        wait_for(process, "staging")
        refused = tworelay(
            "identify", link, *TRAVEL, environment={"TWORELAY_HOME": str(tmp_path / "other")}
        )
        one_line(
            refused, 3, f"another tworelay has the bus of {link} (process {process.pid}, user "
        )
        process.kill()
        process.wait(10)
    stopped_by_its_watchdog(link)
    done = tworelay("restore", "--yes")
    assert done.returncode == 0, done.stderr
    assert_safe_and_complete(link)


def stopped_by_its_watchdog(link: str) -> None:
    """Let its time-out pass, and the stop."""
    drive = opened(link)
    drive.wait(0.5)
    assert not drive.state().is_energised
    drive.close()


@real_time
@posix
def test_killed_in_mid_test_the_drive_stops_and_restore_completes(
    tworelay: Tworelay, serve: Serve
) -> None:
    killed_in_mid_test(tworelay, serve("bench", *WIRES["modbus-tcp"])[0])


@posix
def test_killed_in_mid_test_step_by_step(tworelay: Tworelay, serve: Serve, wire: str) -> None:
    killed_in_mid_test(tworelay, serve("bench", *WIRES[wire], "--clock", "step")[0])


def killed_in_mid_test(tworelay: Tworelay, link: str) -> None:
    with running("identify", link, *TOLD) as process:
        wait_for(process, "staging")
        process.kill()
        process.wait(10)
    stopped_by_its_watchdog(link)
    restored = tworelay("restore", "--yes")
    assert restored.returncode == 0, restored.stderr
    assert "max_torque" in restored.stdout
    assert_safe_and_complete(link)
