"""Gateways as processes, with the real engine: what the technician and the network do to them."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from unittest import mock

import psutil
import pytest

from commissioning.fleet.gateway import keys as keys_module
from commissioning.fleet.ledger import Ledger
from commissioning.result.fleet import JobState
from tests.command import ROOT, in_process, running
from tests.gateways.lines import At, fleet_file, keys_in, until

pytestmark = [
    pytest.mark.skipif(os.name == "nt", reason="signals of POSIX"),
    pytest.mark.xdist_group("gateways"),
    pytest.mark.timeout(170),
]
BENCH = 'link = "virtual://bench?seed={}"\n'


def run(*words: str) -> subprocess.CompletedProcess[str]:
    return in_process("fleet", *words)


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, At]]:
    """Keys, and a gateway with two virtual axes."""
    folder = tmp_path_factory.mktemp("line")
    keys = keys_in(folder / "keys", "pc-a", "pc-b")
    at = At(folder, "pc-a", keys, {"x": BENCH.format(1), "y": BENCH.format(2)})
    with at.running():
        yield keys, at


def test_a_run_is_fetched_and_restored_where_its_drive_is(
    shared: tuple[Path, At], tmp_path: Path, state_folder: Path
) -> None:
    keys, at = shared
    path = fleet_file(tmp_path / "line.toml", {"pc-a": at}, keys)
    done = run("run", str(path), "--job", "commission", "--json", str(tmp_path / "f.json"))
    assert (done.returncode, done.stderr) == (0, ""), done.stdout
    tree = json.loads((tmp_path / "f.json").read_text())
    axes = {axis["name"]: axis for axis in tree["axes"]}
    assert (axes["x"]["gateway"], axes["x"]["link"]) == ("pc-a", "virtual://bench?seed=1")
    found = axes["x"]["outcome"]["coulomb"]
    assert found["low"] < 0.1 < found["high"]
    pages = state_folder / "fleets" / tree["fleet_run"]
    assert {"fleet.html", "acceptance.html"} <= {path.name for path in pages.iterdir()}
    one = axes["x"]["outcome"]["run"]
    kept = state_folder / "runs" / one
    assert (kept / "run.json").is_file(), "result"
    assert any(kept.glob("samples*")), "samples"
    assert in_process("report", one, "--output", str(tmp_path / "r.html")).returncode == 0
    refused = in_process("restore", one, "--yes")
    assert refused.returncode == 3
    assert "is on gateway 'pc-a'" in refused.stderr
    last = in_process("report", "last")
    assert last.returncode == 2, "a fetched run is never the last of this computer"
    back = run("restore", "--axis", "x", "--yes")
    assert back.returncode == 0, back.stdout
    assert "the drive's compensation is as it was found" in back.stdout
    status = run("status", "--json")
    assert {axis["state"] for axis in json.loads(status.stdout)["axes"]} == {"done"}


def _shift(folder: Path, days: int) -> None:
    """Its certificates are of so many days ago."""
    then = datetime.now(UTC) - timedelta(days=days)
    with mock.patch.object(keys_module, "datetime") as clock:
        clock.now.return_value = then
        keys_in(folder, "pc-a", days=30)


def _stranger(keys: Path, folder: Path) -> None:
    keys_in(folder, "pc-a")


def _expired(keys: Path, folder: Path) -> None:
    _shift(folder, 60)
    shutil.copy(keys / "ca.crt", folder / "ca.crt")


def _wrong_role(keys: Path, folder: Path) -> None:
    folder.mkdir()
    shutil.copy(keys / "ca.crt", folder)
    for kind in ("crt", "key"):
        shutil.copy(keys / f"gateway-pc-a.{kind}", folder / f"client-laptop.{kind}")


def _stranger_with_our_authority(keys: Path, folder: Path) -> None:
    keys_in(folder, "pc-a")
    shutil.copy(keys / "ca.crt", folder / "ca.crt")


def _readable(keys: Path, folder: Path) -> None:
    shutil.copytree(keys, folder)
    (folder / "client-laptop.key").chmod(0o644)


def _none(keys: Path, folder: Path) -> None:
    folder.mkdir()


KEYS = {
    "of another authority": (_stranger, "certificate is not taken"),
    "whose certificate nobody here has signed": (
        _stranger_with_our_authority, "does not know the authority",
    ),
    "that has expired": (_expired, "certificate"),
    "with a gateway's certificate": (_wrong_role, "not that of a client"),
    "whose key others can read": (_readable, "others can read it"),
    "without keys": (_none, "must have one certificate of a client"),
}  # fmt: skip


@pytest.mark.parametrize("what", KEYS)
def test_a_client_that_must_not(shared: tuple[Path, At], tmp_path: Path, what: str) -> None:
    keys, at = shared
    prepare, words = KEYS[what]
    prepare(keys, tmp_path / "mine")
    path = fleet_file(tmp_path / "line.toml", {"pc-a": at}, tmp_path / "mine")
    done = run("run", str(path))
    assert done.returncode == 3, done.stdout
    assert re.sub(r"\s+", " ", done.stdout).count(words) >= 1, done.stdout
    assert "Traceback" not in done.stdout + done.stderr
    with Ledger(at.home, reading=True) as ledger:
        assert not ledger.moving()


def test_a_gateway_of_another_name_and_one_that_is_not_there(
    shared: tuple[Path, At], tmp_path: Path
) -> None:
    keys, at = shared
    gone = At(tmp_path, "pc-b", keys, {"z": BENCH.format(3)})
    wrong = fleet_file(tmp_path / "a.toml", {"pc-b": gone}, keys, ports={"pc-b": at.port})
    done = run("check", str(wrong))
    assert done.returncode == 9
    assert "Hostname mismatch" in re.sub(r"\s+", " ", done.stdout)
    nobody = fleet_file(tmp_path / "b.toml", {"pc-b": gone}, keys, ports={"pc-b": 9})
    done = run("check", str(nobody))
    assert done.returncode == 9
    assert "Connection refused" in re.sub(r"\s+", " ", done.stdout)
    unknown = fleet_file(
        tmp_path / "c.toml", {"pc-a": at}, keys, '[[axes]]\nname = "w"\ngateway = "pc-a"\n'
    )
    done = run("check", str(unknown))
    assert done.returncode == 9
    assert "'w'" in done.stdout
    assert "x, y" in done.stdout


def test_what_a_gateway_cannot_begin_with(shared: tuple[Path, At], tmp_path: Path) -> None:
    keys, at = shared
    one = At(tmp_path, "pc-b", keys, {})
    one.port = at.port
    words = one.words()[3:]
    taken = in_process(*words, environment={"TWORELAY_HOME": str(one.home)})
    assert taken.returncode == 4
    assert "in use" in taken.stderr
    again = in_process(*at.words()[3:], environment={"TWORELAY_HOME": str(at.home)})
    assert again.returncode == 3
    assert "is running already" in again.stderr
    code = (
        "import sys; sys.modules['distributed'] = None; from commissioning.cli import main; main()"
    )
    bare = subprocess.run(
        [sys.executable, "-c", code, *words], cwd=ROOT, capture_output=True, text=True, check=False,
        timeout=60,
    )  # fmt: skip
    assert bare.returncode == 2
    assert "pip install 'tworelay[fleet]'" in bare.stderr
    assert bare.stderr.count("\n") == 1


def test_a_plain_client_and_what_is_listened_on(shared: tuple[Path, At]) -> None:
    _, at = shared
    assert at.process is not None
    there = [
        one.laddr for one in psutil.Process(at.process.pid).net_connections("inet")
        if one.status == psutil.CONN_LISTEN
    ]  # fmt: skip
    assert [(place.ip, place.port) for place in there] == [("127.0.0.1", at.port)]
    for text in (b"GET / HTTP/1.0\r\n\r\n", bytes(100), b"\x16\x03\x01\xff\xff" + bytes(300)):
        with socket.create_connection(("127.0.0.1", at.port), 10) as plain:
            plain.settimeout(10)
            with contextlib.suppress(ConnectionError):
                plain.sendall(text)
                assert len(plain.recv(100)) < 100, "no more than an alert"


ENGINE = """
import asyncio, sys
from pathlib import Path
from commissioning.fleet.gateway import engine
from commissioning.fleet.gateway.keys import context, the_one
import dask

async def main():
    _, files = the_one(Path(sys.argv[1]), "client")
    address = f"tls://127.0.0.1:{sys.argv[2]}"
    line = await engine.open_line("pc-a", address, context(files, "client"))
    for name in ("retire_workers", "run_function", "restart", "terminate", "broadcast", "scatter"):
        try:
            await asyncio.wait_for(getattr(line._client.scheduler, name)(), 5)
        except Exception as error:
            print(name, "handler" in str(error) and "disallowed" in str(error))
    print(dask.config.get("distributed.scheduler.allowed-failures"),
          dask.config.get("distributed.scheduler.work-stealing"),
          dask.config.get("distributed.comm.require-encryption"))
    print(await line.call("what", "{}", 5))
    await line.close()

asyncio.run(main())
"""


def test_the_engine_does_nothing_that_we_do_not_use(shared: tuple[Path, At]) -> None:
    keys, at = shared
    done = subprocess.run(
        [sys.executable, "-c", ENGINE, str(keys), str(at.port)], cwd=ROOT, text=True,
        capture_output=True, check=False, timeout=90,
    )  # fmt: skip
    lines = done.stdout.splitlines()
    names = "retire_workers", "run_function", "restart", "terminate", "broadcast", "scatter"
    assert lines[:6] == [f"{name} True" for name in names], done.stdout + done.stderr
    assert lines[6] == "0 False True"
    assert lines[7].startswith("-")


def _state(folder: Path, axis: str) -> JobState:
    with Ledger(folder, reading=True) as ledger:
        return ledger.rows(ledger.record("last").id)[axis].state


@pytest.mark.parametrize("how", ["killed", "frozen", "ended"])
def test_a_gateway_fails_in_mid_motion(how: str, tmp_path: Path, state_folder: Path) -> None:
    keys = keys_in(tmp_path / "keys", "pc-a")
    with At(tmp_path, "pc-a", keys, {"x": BENCH.format(1)}, 100.0).running() as at:
        path = fleet_file(tmp_path / "line.toml", {"pc-a": at}, keys)
        with running("fleet", "run", str(path)) as process:
            until(lambda: (at.home / "journal.sqlite").exists() and at.moving())
            if how == "killed":  # its fake job dies with it, as with the computer
                at.kill()
                at.begin()
            elif how == "frozen":
                at.send(signal.SIGSTOP)
                until(lambda: _state(state_folder, "x") is JobState.STARTED)
                at.send(signal.SIGCONT)
                at.let_end()
            else:
                at.send(signal.SIGTERM)
                until(lambda: at.process is not None and at.process.poll() is not None)
                at.end()
                at.begin()
            out, errors = process.communicate(timeout=120)
        state = _state(state_folder, "x")
        expected = {"killed": JobState.UNKNOWN, "frozen": JobState.DONE, "ended": JobState.STOPPED}
        assert state is expected[how], out + errors
        assert len(at.moves()) == 1
        assert process.returncode == (0 if how == "frozen" else 9), out + errors
        if how == "killed":
            assert "NOT VERIFIED" in out


def test_the_client_dies_and_the_axis_ends_as_its_ledger_says(
    tmp_path: Path, state_folder: Path
) -> None:
    keys = keys_in(tmp_path / "keys", "pc-a")
    axes = {"x": BENCH.format(1), "y": BENCH.format(2)}
    with At(tmp_path, "pc-a", keys, axes, 100.0).running() as at:
        path = fleet_file(tmp_path / "line.toml", {"pc-a": at}, keys)
        with running("fleet", "run", str(path), "--at-once", "1") as process:
            until(lambda: len(at.moves()) == 1)
            process.kill()
            process.communicate()
        assert "is under way still on gateway 'pc-a'" in run("status").stdout
        again = run("run", str(path), "--resume")
        assert again.returncode == 3
        assert "on gateway 'pc-a'" in again.stderr
        at.let_end()
        until(lambda: not at.moving())
        assert len(at.moves()) == 1, "nothing new begins without a client"
        run("status")
        assert _state(state_folder, at.moves()[0].split()[1]) is JobState.DONE
        resumed = run("run", str(path), "--resume")
        assert resumed.returncode == 0, resumed.stdout
        assert sorted(line.split()[1] for line in at.moves()) == ["x", "y"]


def test_a_stop_reaches_through_the_gateway_without_a_runner(
    tmp_path: Path, state_folder: Path
) -> None:
    keys = keys_in(tmp_path / "keys", "pc-a")
    with At(tmp_path, "pc-a", keys, {"x": BENCH.format(1)}, 100.0).running() as at:
        path = fleet_file(tmp_path / "line.toml", {"pc-a": at}, keys)
        with running("fleet", "run", str(path)) as process:
            until(lambda: len(at.moves()) == 1)
            process.kill()
            process.communicate()
        at.send(signal.SIGSTOP)
        lost = run("stop")
        at.send(signal.SIGCONT)
        assert lost.returncode == 4, lost.stdout
        stopped = run("stop")
        assert stopped.returncode == 0, stopped.stderr
        assert "gateway 'pc-a': x – confirmed" in stopped.stdout
        assert _state(state_folder, "x") is JobState.STOPPED
