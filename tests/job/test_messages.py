"""Messages that once sent people the wrong way: each names the cause, and what would do."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from commissioning.ownership import note_stop, stopped_by
from tests.conftest import Serve, Tworelay
from tests.serving import WIRES


@pytest.mark.parametrize(
    "axis", ["vertical --travel 3", "bench --travel 3 --watchdog 0.5", "bench --travel 0.1"]
)
def test_too_little_travel_names_what_would_do_and_it_does(tworelay: Tworelay, axis: str) -> None:
    name, *options = axis.split()
    done = tworelay("identify", f"virtual://{name}", *options, "--yes")
    assert done.returncode == 3
    found = re.search(r"--travel ([\d.]+) or --watchdog ([\d.]+) would do", done.stderr)
    assert found is not None, done.stderr
    assert "±0 rad" not in done.stderr
    for instead in (["--travel", found[1]], [*options[:2], "--watchdog", found[2]]):
        done = tworelay("identify", f"virtual://{name}", *instead, "--yes")
        assert "is too small" not in done.stderr


@pytest.mark.parametrize(
    ("link", "words"),
    [
        ("modbus-tcp://127.0.0.1?foo", "'foo' has no value"),
        ("modbus-tcp://127.0.0.1?unit=1&foo", "'foo' has no value"),
        ("canopen://socketcand/can0?node=5", "canopen://socketcan/can0"),
    ],
)
def test_a_mistyped_link(tworelay: Tworelay, link: str, words: str) -> None:
    done = tworelay("identify", link, "--profile", "cia402" if "can" in link else "virtual-modbus")
    assert done.returncode == 2
    assert words in done.stderr


def test_a_port_that_is_taken(tworelay: Tworelay) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        place = f"127.0.0.1:{taken.getsockname()[1]}"
        for wire in ("--modbus-tcp", "--socketcand"):
            done = tworelay("virtual", "serve", "bench", wire, place)
            assert done.returncode == 2
            assert f"cannot serve on {place}: another program listens there" in done.stderr
            assert "Error" not in done.stderr


def test_the_list_shows_the_friction_that_acts(tworelay: Tworelay) -> None:
    assert "Coulomb 7 (motor 3.3, load 3.7) N.m" in tworelay("virtual", "list").stdout


def test_a_speed_limit_that_reads_zero_is_one(
    serve: Serve, tworelay: Tworelay, tmp_path: Path
) -> None:
    link = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]
    from drivers.link import open_drive
    from profiles.axis import Axis

    drive = open_drive(Axis(link=link, profile="virtual-modbus"))
    drive.write("max_speed", 0)
    drive.close()
    done = tworelay("identify", link, "--travel", "3", "--yes")
    assert done.returncode == 2
    assert "speed limit (register 0312h) reads 0: give --max-speed in rad/s" in done.stderr


def test_who_stopped_an_axis_is_named() -> None:
    link = "modbus-tcp://127.0.0.1:502?unit=1"
    assert stopped_by(link, 5.0) == ""
    note_stop(link)
    assert re.match(r"process \d+, user .*, tworelay stop, since", stopped_by(link, 5.0))
    assert stopped_by(link, -1.0) == "", "that was before"


@pytest.mark.real_time
def test_a_job_that_tworelay_stop_ends_says_so(serve: Serve, tworelay: Tworelay) -> None:
    link = serve("bench", *WIRES["modbus-tcp"])[0]
    job = subprocess.Popen(
        [sys.executable, "-m", "commissioning", "identify", link, "--travel", "20", "--cycle",
        "0.01",
         "--yes", "-v"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert job.stdout is not None
    for line in job.stdout:
        if "relay at" in line:
            break
    reader = threading.Thread(target=job.stdout.read)
    reader.start()
    time.sleep(0.3)
    tworelay("stop", link)
    reader.join()
    assert job.stderr is not None
    said = job.stderr.read()
    job.stderr.close()
    job.stdout.close()
    assert job.wait() == 5
    assert "tworelay stop" in said, said


def test_a_scan_of_a_server_that_answers_for_everybody_ends_soon() -> None:
    from drivers.scan import scan
    from tests.peers import gateway

    asked: list[int] = []
    with gateway({}, "data") as port:
        found = scan(f"modbus-tcp://127.0.0.1:{port}", range(1, 248), None, asked.append)
    assert [item.note for item in found] == ["answers to every unit number: it is one drive"]
    assert asked == [1, 2, 3, 4]


def test_a_drive_that_does_not_say_who_it_is_is_told_in_whole_words(
    serve: Serve, tworelay: Tworelay
) -> None:
    link = serve("bench", *WIRES["modbus-tcp"], "--clock", "step", "--habit", "mute43")[0]
    done = tworelay("identify", link, "--travel", "3", "--yes")
    assert done.returncode == 3
    assert (
        "the drive does not say who it is, so its profile is not known: give --profile"
        in done.stderr
    )


def test_latency_is_not_bounded_by_the_watchdog_that_it_recommends(
    serve: Serve, tworelay: Tworelay
) -> None:
    """Every answer 30 ms later: more than a quarter of the 50 ms that the drive bears."""
    link = serve("bench", *WIRES["modbus-tcp"], "--habit", "slow-answer=0.03")[0]
    done = tworelay("latency", link, "--count", "50")
    assert done.returncode == 0, done.stderr
    cycle = re.search(r"\(--cycle ([\d.]+)\)", done.stdout)
    watchdog = re.search(r"give --watchdog ([\d.]+)", done.stdout)
    assert cycle is not None
    assert watchdog is not None, done.stdout
    assert float(cycle[1]) > 0.03
    assert float(watchdog[1]) >= 3 * float(cycle[1])


@pytest.mark.parametrize(
    ("wire", "habit"),
    [("modbus-tcp", "mute43"), ("modbus-tcp", "busy=2"), ("modbus-tcp", "slow-boot=0.1"),
     ("socketcand", "busy=2"), ("socketcand", "busy=3")],
)  # fmt: skip
def test_a_drive_that_does_not_say_who_it_is_is_stopped_all_the_same(
    serve: Serve, tworelay: Tworelay, wire: str, habit: str
) -> None:
    link = serve("bench", *WIRES[wire], "--habit", habit)[0]
    profile = "virtual-modbus" if wire == "modbus-tcp" else "virtual-canopen"
    done = tworelay("stop", link, "--profile", profile)
    assert done.returncode == 0, done.stderr
    assert "de-energised" in done.stdout
