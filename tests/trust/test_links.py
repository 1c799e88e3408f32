"""A LINK is names and known options: it overwrites no file, and opens no handler of a library."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from drivers.link import is_simulated, parse
from profiles.errors import UsageError
from tests.command import in_this_process as tworelay

HANDLERS = [
    "modbus-rtu:spy:///dev/null?file={file}",
    "modbus-rtu:spy%3A%2F%2F%2Fdev%2Fnull%3Ffile={file}",
    "modbus-rtu:///spy://{file}?unit=1",
    "modbus-rtu:///loop://?unit=1",
    "modbus-rtu:socket%3A%2F%2F127.0.0.1:1",
    "modbus-rtu:///dev/ttyUSB0?file={file}",
    "canopen://slcan/spy%3A%2F%2F%2Fdev%2Fnull%3Ffile%3D{file}?node=5",
    "canopen://slcan/socket%3A%2F%2F127.0.0.1:1?node=5",
    "canopen://slcan/%2Fdev%2FttyACM0@x?node=5",
    "canopen://slcan/%2Fdev%2FttyACM0?node=5&logfile={file}",
    "canopen://../x/can0?node=5",
    "canopen://socketcan/can0%00?node=5",
    "canopen://socketcan/can0;rm?node=5",
    "canopen://socketcand/a@b:1/can0?node=5",
    "canopen://socketcand/127.0.0.1:70000/can0?node=5",
    "modbus-tcp://user@host:502",
    "modbus-tcp://host/path:502",
    "modbus-tcp://a%0Ab:502",
    "modbus-tcp://[::1:502",
    "modbus-tcp://h:1?unit=1&unit=2",
    "modbus-tcp://h:1?ca={file}",
    "modbus-tcp://h:1#?state={file}",
    "virtual://bench/../x",
    "virtual://bench?state={file}%00",
    "virtual://bench?state=",
    "virtual://bench?state=a&state={file}",
    "modbus-tcp://h:1?\x1b]0;x\x07=1",
    "modbus-tcp://" + "h" * 5000,
]  # fmt: skip
ACTS = [
    ("doctor",),
    ("identify", "--dry-run"),
    ("identify", "--yes"),
    ("stop",),
    ("latency",),
    ("scan",),
]
_MINE = "what the user wrote\n"


@pytest.mark.parametrize("link", HANDLERS)
@pytest.mark.parametrize("act", ACTS, ids=" ".join)
def test_what_is_no_name_is_refused_by_every_act(
    act: tuple[str, ...], link: str, tmp_path: Path
) -> None:
    file = tmp_path / "mine.txt"
    file.write_text(_MINE)
    done = tworelay(*act, link.format(file=file))
    assert done.returncode == 2, done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert "\x1b" not in done.stderr + done.stdout
    assert file.read_text() == _MINE
    assert sorted(p.name for p in tmp_path.iterdir() if p.name != "home") == ["mine.txt"]


@pytest.mark.parametrize(
    "act", [("identify", "--dry-run"), ("identify", "--yes"), ("tune", "--yes")]
)
@pytest.mark.parametrize(
    "content", [_MINE, "", '{"a": 1}', '["coulomb_positive"]', '{"schema": "tworelay.memory/2"}',
    '{"schema": "tworelay.memory/1", "a": "b"}', "{" * 100_000],
)  # fmt: skip
def test_a_state_that_is_not_ours_is_never_written(
    act: tuple[str, ...], content: str, tmp_path: Path
) -> None:
    file = tmp_path / "mine.json"
    file.write_text(content)
    done = tworelay(*act, f"virtual://bench?state={file}")
    assert done.returncode == 2
    assert "is no memory of a virtual drive" in done.stderr
    assert file.read_text() == content
    served = tworelay(
        "virtual", "serve", "bench", "--modbus-tcp", "127.0.0.1:0", "--state", str(file)
    )
    assert served.returncode == 2
    assert file.read_text() == content


def test_a_state_that_is_a_folder_a_device_or_leads_nowhere_is_refused(tmp_path: Path) -> None:
    nowhere = tmp_path / "nowhere"
    nowhere.symlink_to(tmp_path / "not there" / "x")
    for place in (tmp_path, nowhere, Path(os.devnull)):
        assert tworelay("identify", "--yes", f"virtual://bench?state={place}").returncode == 2


def test_a_state_of_ours_is_written_again_also_one_of_an_older_version(tmp_path: Path) -> None:
    file = tmp_path / "drive.json"
    kept: dict[str, Any] = {}
    for old in (False, True):
        if old:
            file.write_text(json.dumps({k: v for k, v in kept.items() if k != "schema"}))
        share = ("--fraction", "0.7") if old else ()  # else there is nothing to store
        done = tworelay("commission", f"virtual://bench?state={file}", "--yes", *share)
        assert done.returncode == 0, done.stderr
        kept = json.loads(file.read_text())
        assert kept["schema"] == "tworelay.memory/1"
        assert kept["coulomb_positive"] > 0


@pytest.mark.skipif(not Path("/dev/pts").is_dir(), reason="this system has no /dev/pts")
def test_what_leads_out_of_the_pseudo_terminals_is_not_simulated(tmp_path: Path) -> None:
    near, far = os.openpty()
    alias = tmp_path / "port"
    alias.symlink_to(os.ttyname(far))
    try:
        assert is_simulated(f"modbus-rtu://{os.ttyname(far)}")
        assert is_simulated(f"modbus-rtu://{alias}")
        assert not is_simulated("modbus-rtu:///dev/pts/../ttyUSB0")
        assert not is_simulated("canopen://slcan/%2Fdev%2Fpts%2F..%2FttyACM0?node=5")
        assert not is_simulated("modbus-rtu:///dev/pts")
    finally:
        os.close(near)
        os.close(far)


@pytest.mark.parametrize(
    "link", ["modbus-rtu:COM5?unit=1", r"modbus-rtu:\\.\COM12", "modbus-rtu:///dev/serial/by-id/usb-A_b-if00",
    "canopen://slcan/COM3?node=5", "canopen://pcan/PCAN_USBBUS1?node=5", "canopen://kvaser/0?node=5",
    "modbus-tcp://[fe80::1]:502?unit=1", "modbus-tcp://drive-7.plant_2:502", "modbus-tcp://10.0.0.1",
    "canopen://socketcand/[::1]:29536/can0?node=5", "canopen://slcan/%2Fdev%2FttyACM0?node=5&bitrate=500000",
    "canopen://slcan/%2Fdev%2FttyACM0@115200?node=5"],
)  # fmt: skip
def test_what_people_have_is_a_link(link: str) -> None:
    assert parse(link).text == link


def test_a_link_in_an_axis_file_is_read_as_strictly(tmp_path: Path) -> None:
    file = tmp_path / "press.toml"
    file.write_text('link = "modbus-rtu:///spy://x?unit=1"\n')
    assert tworelay("identify", str(file), "--dry-run").returncode == 2
    with pytest.raises(UsageError):
        parse("modbus-rtu:///spy://x?unit=1")
