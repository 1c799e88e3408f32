"""One owner a bus, by every name that a link can give it, for every user of the machine."""

from __future__ import annotations

import contextlib
import getpass
import os
import re
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Generator
from pathlib import Path

import pytest

import commissioning.locks
import commissioning.ownership
from commissioning.locks import FileLock, Lock, Taken, take
from commissioning.ownership import announce, owned
from drivers.places import buses
from profiles.errors import Refused
from tests.command import ROOT, in_process
from tests.conftest import Serve, Tworelay
from tests.raising import raises

NOBODY = 65534
needs_root = pytest.mark.skipif(
    os.name == "nt" or os.geteuid() != 0, reason="only root can act as two users"
)
linux = pytest.mark.skipif(sys.platform != "linux", reason="abstract sockets are Linux'")


@pytest.fixture(autouse=True)
def locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where locks would be files."""
    folder = tmp_path / "tworelay-locks"
    monkeypatch.setattr(commissioning.locks, "_FOLDER", folder)
    return folder


@pytest.fixture(params=["the system's", "a file"])
def kind(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The lock of this system, and that of those without named objects."""
    if request.param == "a file":
        monkeypatch.setattr(commissioning.ownership, "take", FileLock)


@pytest.fixture
def apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Names that are nobody else's: other tests may run on this machine at the same time."""
    salt = uuid.uuid4().hex[:8]
    kind = vars(commissioning.ownership)["take"]  # that of `kind`, where it is used
    monkeypatch.setattr(
        commissioning.ownership, "take", lambda name, doing: kind(salt + name[8:], doing)
    )


def own_name() -> str:
    """Of this user, where there is one."""
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return ""


def in_another_thread(link: str) -> str:
    """What another job is told that wants the bus; '' when it gets it."""
    told: list[str] = []

    def job() -> None:
        try:
            with owned(link, "another"):
                told.append("")
        except Refused as error:
            told.append(str(error))

    thread = threading.Thread(target=job)
    thread.start()
    thread.join()
    return told[0]


LOCAL = "modbus-tcp://127.0.0.1:1502?unit=1"


@pytest.mark.usefixtures("kind", "apart")
def test_a_refusal_names_process_user_run_and_since_when() -> None:
    with owned(LOCAL, "apply"):
        announce("run 20261125-140305-x")
        told = in_another_thread(LOCAL)
    words = (
        rf"another tworelay has the bus of {re.escape(LOCAL)} \(process {os.getpid()}, (user \S+, "
        r")?"
        r"run 20261125-140305-x, since \d\d:\d\d:\d\d\): wait for it, or end it; "
        "'tworelay stop' works in spite of it"
    )
    assert re.fullmatch(words, told), told
    assert in_another_thread(LOCAL) == ""


@pytest.mark.usefixtures("kind", "apart")
def test_a_job_owns_a_bus_around_its_steps() -> None:
    with owned(LOCAL, "commission"):
        with owned(LOCAL, "identify"), owned(LOCAL, "apply"):
            assert in_another_thread(LOCAL)
        assert in_another_thread(LOCAL), "the job goes on"
    assert not in_another_thread(LOCAL)


@pytest.mark.usefixtures("apart")
@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("modbus-tcp://127.0.0.1:1502?unit=1", "modbus-tcp://127.0.0.1:1502?unit=2"),
        ("modbus-tcp://localhost:1502", "modbus-tcp://127.0.0.1:1502"),
        ("modbus-tcp://LOCALHOST.:1502", "modbus-tcp://[::ffff:127.0.0.1]:1502"),
        ("modbus-tcp://127.0.0.1", "modbus-rtu-tcp://127.0.0.1:502"),
        ("modbus-tls://127.0.0.1", "modbus-tcp://localhost:802"),
        ("modbus-tcp://127.0.0.1:0502", "modbus-tcp://127.0.0.1"),
        ("modbus-tcp://0.0.0.0:1502", "modbus-tcp://127.0.0.1:1502"),
        ("modbus-tcp://[::1]:1502", "modbus-tcp://[0:0:0:0:0:0:0:1]:1502"),
        ("modbus-tcp://no.such.host.invalid:1", "modbus-tcp://NO.such.host.invalid:1?unit=3"),
        ("canopen://socketcan/can0?node=5", "canopen://socketcan/can0?node=6&sync=bus"),
        ("canopen://socketcand/127.0.0.1:28600/can0?node=5",
         "canopen://socketcand/localhost:28600/can0?node=6"),
        ("modbus-rtu:///dev/ttyUSB0?unit=1", "canopen://slcan/%2Fdev%2FttyUSB0?node=6"),
        ("canopen://slcan/%2Fdev%2FttyS9?node=5", "canopen://slcan/%2Fdev%2FttyS9@115200?node=6"),
        ("modbus-rtu:COM5?unit=1", r"modbus-rtu:\\.\com5?unit=2"),
        ("modbus-rtu:COM5", "modbus-rtu:///COM5"),
        ("modbus-rtu:COM5", "canopen://slcan/COM5?node=1"),
        ("modbus-rtu:///dev/../dev/ttyX1", "modbus-rtu:///dev/ttyX1"),
        ("canopen://virtual/a?node=1", "canopen://virtual/a?node=2"),
    ],
)  # fmt: skip
def test_one_bus_by_two_names(first: str, second: str) -> None:
    assert set(buses(first)) & set(buses(second))
    with owned(first, "first"):
        assert in_another_thread(second)
    with owned(second, "second"):
        assert in_another_thread(first)


@pytest.mark.usefixtures("apart")
@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("modbus-tcp://127.0.0.1:1502", "modbus-tcp://127.0.0.1:1503"),
        ("modbus-tcp://127.0.0.1:1502", "modbus-tcp://127.0.0.2:1502"),
        ("canopen://socketcan/can0?node=5", "canopen://socketcan/can1?node=5"),
        ("canopen://socketcan/can0?node=5", "canopen://kvaser/can0?node=5"),
        ("canopen://socketcand/127.0.0.1:28600/can0?node=5",
         "canopen://socketcand/127.0.0.1:28600/can1?node=5"),
        ("modbus-rtu:COM5", "modbus-rtu:COM51"),
        ("modbus-rtu:///dev/ttyX0", "modbus-rtu:///dev/ttyX1"),
        ("virtual://bench", "virtual://bench"),
    ],
)  # fmt: skip
def test_two_buses(first: str, second: str) -> None:
    with owned(first, "first"):
        assert not in_another_thread(second)


@pytest.mark.skipif(os.name == "nt", reason="pseudo-terminals are POSIX'")
def test_a_port_by_whatever_file_leads_to_it(tmp_path: Path) -> None:
    """As udev's /dev/serial/by-id does; and by a device file of its own."""
    master, slave = os.openpty()
    port = os.ttyname(slave)
    link = tmp_path / "usb-FTDI-if00"
    link.symlink_to(port)
    assert buses(f"modbus-rtu://{link}") == buses(f"modbus-rtu://{port}")
    if os.geteuid() == 0:
        twin = tmp_path / "ttyTwin"
        with contextlib.suppress(PermissionError):  # no device may be made in a container
            os.mknod(twin, 0o020600, Path(port).stat().st_rdev)
            assert buses(f"modbus-rtu://{twin}") == buses(f"modbus-rtu://{port}")
    for descriptor in (master, slave):
        os.close(descriptor)


@pytest.mark.usefixtures("apart")
def test_a_name_with_two_addresses_is_held_at_both(monkeypatch: pytest.MonkeyPatch) -> None:
    found = {"drive": ["10.0.0.1", "10.0.0.2"], "10.0.0.2": ["10.0.0.2"]}
    monkeypatch.setattr(
        "socket.getaddrinfo", lambda host, *a, **k: [(0, 0, 0, "", (x, 0)) for x in found[host]]
    )
    assert buses("modbus-tcp://drive") == ("tcp 10.0.0.1 502", "tcp 10.0.0.2 502")
    with owned("modbus-tcp://10.0.0.2", "second"):
        assert in_another_thread("modbus-tcp://drive")
        assert not _locks_of_this_thread() - {"tcp 10.0.0.2 502"}


def _locks_of_this_thread() -> set[str]:
    return set(commissioning.ownership._mine.locks)


# -- users ----------------------------------------------------------------------------------------


@contextlib.contextmanager
def as_nobody() -> Generator[None]:
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)


@needs_root
@pytest.mark.parametrize("make", [take, FileLock], ids=["the system's", "a file"])
def test_another_user_s_lock_is_held_and_free_again_after_it(
    make: type[FileLock], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "shared"
    folder.mkdir()
    folder.chmod(0o1777)
    for parent in [folder, *folder.parents][:-1]:
        parent.chmod(parent.stat().st_mode | 0o055)
    monkeypatch.setattr(commissioning.locks, "_FOLDER", folder / "locks")
    name = f"test-{time.time_ns()}"
    mine: Lock = make(name, "mine")
    with as_nobody(), pytest.raises(Taken, match="user root, mine, since"):
        make(name, "theirs")
    mine.release()
    with as_nobody():
        theirs = make(name, "theirs")
    with pytest.raises(Taken, match=r"process \d+"):
        make(name, "mine")
    with as_nobody():
        theirs.release()
    make(name, "mine").release()


@needs_root
@linux
def test_a_refusal_names_the_other_user() -> None:
    name = f"test-{time.time_ns()}"
    with as_nobody():
        theirs = take(name, "run x")
    with pytest.raises(Taken) as caught:
        take(name, "mine")
    assert (caught.value.owner.process, caught.value.owner.user) == (os.getpid(), "nobody")
    theirs.release()


@needs_root
def test_a_lock_that_cannot_be_asked_is_held(locks: Path, tmp_path: Path) -> None:
    """A file that another user has made, and keeps to itself."""
    locks.mkdir()
    (locks / "bus").write_text("")
    (locks / "bus").chmod(0o600)
    for parent in [locks, *locks.parents][:-1]:
        parent.chmod(parent.stat().st_mode | 0o055)
    with as_nobody(), pytest.raises(Taken, match="process unknown"):
        FileLock("bus", "mine")


@pytest.mark.skipif(os.name == "nt", reason="files are no locks there")
def test_a_lock_file_names_its_owner_and_not_those_before(locks: Path) -> None:
    FileLock("bus", "a long, long errand").release()
    lock = FileLock("bus", "run 1")
    process, user, since, doing = (locks / "bus").read_text().split("\t")
    assert (int(process), doing) == (os.getpid(), "run 1")
    assert user in (os.environ.get("LOGNAME"), os.environ.get("USER"), "", own_name())
    assert abs(float(since) - time.time()) < 60
    lock.release()


@pytest.mark.skipif(os.name == "nt", reason="files are no locks there")
def test_without_a_folder_for_locks_nothing_is_owned(locks: Path) -> None:
    locks.write_text("a file where the folder should be")
    with raises(Refused, "refused.lock"):
        FileLock("bus", "mine")


# -- who asks -------------------------------------------------------------------------------------


def test_whatever_opens_a_link_asks_and_stop_does_not(serve: Serve, tworelay: Tworelay) -> None:
    """Each is refused, says by whom, and works when the bus is free."""
    link = serve("bench", "--modbus-tcp", "127.0.0.1:0", "--clock", "wall")[0]
    port = link.rpartition(":")[2].partition("?")[0]
    bus = f"modbus-tcp://localhost:{port}"
    asking = [
        ("scan", bus, "--units", "1-1"), ("doctor", f"{bus}?unit=1"),
        ("latency", f"{bus}?unit=1", "--count", "50"),
        ("identify", f"{bus}?unit=1", "--travel", "1", "--dry-run"),
        ("tune", f"{bus}?unit=1"),
        ("profile", "new", "--drive", f"canopen://socketcand/localhost:{port}/can0?node=5",
         "--output", "drive.toml"),
    ]  # fmt: skip
    held = (link, f"canopen://socketcand/127.0.0.1:{port}/can0")
    with contextlib.ExitStack() as stack:
        ready, done = threading.Event(), threading.Event()

        def hold() -> None:
            with owned(held[0], "run A"), owned(held[1], "run A"):
                ready.set()
                done.wait(60)

        thread = threading.Thread(target=hold)
        thread.start()
        stack.callback(thread.join)
        stack.callback(done.set)
        ready.wait(10)
        for words in asking:
            refused = tworelay(*words)
            if words[0] == "tune":  # of a link it reads nothing
                continue
            assert refused.returncode == 3, (words, refused.stderr)
            assert f"(process {os.getpid()}, user " in refused.stderr
            assert re.search(r"run A, since \d\d:\d\d", refused.stderr)
        assert tworelay("stop", link).returncode == 0
    for words in asking[:4]:
        assert tworelay(*words).returncode == 0, words


def test_a_lock_ends_with_its_process_however_it_ends(serve: Serve) -> None:
    """By a process that holds it, and is killed."""
    link = serve("bench", "--modbus-tcp", "127.0.0.1:0", "--clock", "step")[0]
    hold = (
        "from commissioning.ownership import owned\n"
        f"with owned({link!r}, 'there'): print('ready', flush=True); input()"
    )
    holder = subprocess.Popen(
        [sys.executable, "-c", hold], cwd=ROOT, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    )  # fmt: skip
    with holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "ready\n"
        refused = in_process("scan", link)
        assert refused.returncode == 3
        assert re.search(rf"\(process {holder.pid}, user \S+, there, since", refused.stderr)
        assert in_another_thread(link)
        holder.kill()
    assert in_process("scan", link, "--units", "1-1").returncode == 0
    assert not in_another_thread(link)
