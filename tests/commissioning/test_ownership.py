"""One owner a drive, by the link to it."""

from __future__ import annotations

import contextlib
import os
import stat
import tempfile
from pathlib import Path

import pytest

from commissioning.ownership import owned
from profiles.errors import Refused


@pytest.fixture(autouse=True)
def locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path / "tworelay-locks"


def is_free(first: str, second: str) -> bool:
    """Whether a second program may have `second` while this one has `first`."""
    with owned(first), contextlib.suppress(Refused), owned(second):
        return True
    return False


def test_a_refusal_names_process_and_link() -> None:
    link = "modbus-tcp://h:502?unit=1"
    words = rf"another tworelay \(process {os.getpid()}\) has the drive on modbus-tcp://h:502"
    with owned(link), pytest.raises(Refused, match=words), owned(link):
        pass


@pytest.mark.parametrize(
    ("first", "second", "free"),
    [
        ("modbus-tcp://h:502?unit=1", "modbus-tcp://h:502?unit=1", False),
        ("modbus-tcp://h:502?unit=1", "modbus-tcp://h:502?unit=1&timeout=2", False),
        ("modbus-tcp://h:502?unit=1", "modbus-tcp://h:502?unit=2", True),
        ("modbus-tcp://h:502?unit=1", "modbus-tcp://g:502?unit=1", True),
        ("canopen://socketcan/can0?node=5", "canopen://socketcan/can0?node=5&sync=bus", False),
        ("canopen://socketcan/can0?node=5", "canopen://socketcan/can0?node=6", True),
        ("modbus-rtu:///dev/ttyUSB0?unit=1", "modbus-rtu:///dev/ttyUSB0?unit=2", False),
        ("canopen://slcan/%2Fdev%2FttyS0?node=5", "canopen://slcan/%2Fdev%2FttyS0?node=6", False),
        ("virtual://bench", "virtual://bench", True),
    ],
)
def test_a_drive_has_one_owner_and_a_serial_port_too(first: str, second: str, free: bool) -> None:
    assert is_free(first, second) is free
    assert is_free(second, first) is free, "the first gave it back"


@pytest.mark.skipif(os.name == "nt", reason="permissions are POSIX'")
def test_every_user_can_take_a_lock_that_another_has_made(locks: Path) -> None:
    before = os.umask(0)
    try:
        with owned("modbus-tcp://h?unit=1"):
            (file,) = locks.iterdir()
            assert stat.S_IMODE(file.stat().st_mode) == 0o666
            assert file.read_text() == str(os.getpid())
    finally:
        os.umask(before)


def test_a_lock_names_its_owner_and_not_those_before(locks: Path) -> None:
    with owned("modbus-tcp://h?unit=1"):
        (file,) = locks.iterdir()
    file.write_text("9" * 12)
    with owned("modbus-tcp://h?unit=1"):
        assert file.read_text() == str(os.getpid())


def test_without_a_folder_for_locks_nothing_is_owned(locks: Path) -> None:
    locks.write_text("a file where the folder should be")
    with pytest.raises(Refused, match="no lock can be made in"), owned("modbus-tcp://h?unit=1"):
        pass
