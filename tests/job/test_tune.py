"""tworelay tune, apply --gains, plot loci: as a user types them."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from drivers.home import home
from drivers.link import axis_of, open_drive
from profiles.library import source_text
from tests.command import ROOT
from tests.conftest import Serve, Tworelay

SCHEMA = json.loads((ROOT / "docs" / "run.schema.json").read_text())


def sets_of(result: dict[str, Any], loop: str, source: str) -> dict[str, dict[str, Any]]:
    return {s["rule"]: s for s in result["tuning"] if s["loop"] == loop and s["source"] == source}


def refused(done: Any, code: int, words: str) -> None:
    assert done.returncode == code, (done.stdout, done.stderr)
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    assert words in done.stderr


@pytest.fixture
def tuned(after: Tworelay) -> dict[str, Any]:
    done = after("tune", "virtual://bench", "--yes", "--json", "-")
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_a_target_is_measured_with_its_points_and_then_tuned(tuned: dict[str, Any]) -> None:
    jsonschema.validate(tuned, SCHEMA)
    assert tuned["critical_point"]["at_180"]["how"] == "measured"
    host, drive = (sets_of(tuned, loop, "corrected") for loop in ("host", "drive"))
    assert len(host) == len(drive) == 9
    # Ku of the loop over the link against the drive's own: 7 to 60 times (method.md 6)
    ku = [1 / sets["tyreus-luyben-pid"]["point"]["gain"] for sets in (host, drive)]
    assert 7 < ku[1] / ku[0] < 60
    for item in tuned["tuning"]:
        if item["proposed"]:
            assert item["source"] == "corrected"
            assert item["phase_margin_deg"] >= 30
            assert item["ms"] <= 2.5
        else:
            assert item["why_not"]
    assert host["ziegler-nichols-pi"]["why_not_code"] == "gains.unstable"
    assert sum(item["best"] for item in tuned["tuning"]) == 2


def test_a_run_is_tuned_without_the_drive_and_keeps_its_gains(
    tworelay: Tworelay, tuned: dict[str, Any]
) -> None:
    done = tworelay("tune", tuned["run"])
    assert done.returncode == 0, done.stderr
    for words in ("host: the loop over this link", "drive: the drive's own loops", "best: cascade"):
        assert words in done.stdout
    report = Path(tworelay("report", "last").stdout.strip()).read_text("utf-8")
    assert "What each tuning rule is worth" in report
    assert report.split("<footer>")[0].count("<svg") == 9


def test_gains_are_written_only_by_name_and_taken_back(tworelay: Tworelay, serve: Serve) -> None:
    (link,) = serve("bench", "--modbus-tcp", "127.0.0.1:0", "--clock", "step")
    done = tworelay("tune", link, "--travel", "3", "--yes", "--json", "-")
    assert done.returncode == 0, done.stderr
    best = next(s for s in json.loads(done.stdout)["tuning"] if s["best"] and s["loop"] == "drive")

    def in_drive() -> list[int]:
        drive = open_drive(axis_of(link))
        found = [drive.read(item["parameter"]).raw for item in best["parameters"]]
        drive.close()
        return found

    before = in_drive()
    assert tworelay("apply", "last", "--yes").returncode == 0
    assert in_drive() == before, "compensation alone"
    written = tworelay("apply", "last", "--gains", "cascade", "--yes", "--json", "-")
    assert written.returncode == 0, written.stderr
    assert in_drive() == [item["new_raw"] for item in best["parameters"]] != before
    result = json.loads(written.stdout)
    jsonschema.validate(result, SCHEMA)
    page = Path(tworelay("report", "last").stdout.strip()).read_text("utf-8")
    assert re.findall(r"(best|yes|no: [^<,]*), written", page) == ["best"], "one set, and no other"
    gains = {one["parameter"] for one in result["written"] if one["kind"] == "gain"}
    assert gains == {item["parameter"] for item in best["parameters"]}
    restored = tworelay("restore", "--yes")
    assert restored.returncode == 0, restored.stderr
    assert in_drive() == before


def test_gains_that_are_not_proposed_or_not_mapped_are_refused(
    tworelay: Tworelay, tuned: dict[str, Any]
) -> None:
    run = tuned["run"]
    refused(tworelay("apply", run, "--gains", "ziegler-nichols-pid", "--yes"), 3, "below 30°")
    refused(tworelay("apply", run, "--gains", "tyreus-luyben-pid", "--yes"), 3, "does not map")
    refused(tworelay("apply", run, "--gains", "magic", "--yes"), 2, "no rule with gains")


def test_a_run_that_was_not_tuned_has_no_gains_to_write(
    tworelay: Tworelay, after: Tworelay
) -> None:
    assert after("identify", "virtual://bench", "--yes").returncode == 0
    refused(tworelay("apply", "last", "--gains", "cascade", "--yes"), 3, "'tworelay tune")


def test_a_rejected_run_gets_no_gains(tworelay: Tworelay) -> None:
    assert tworelay("identify", "virtual://bench?coulomb=1.5", "--yes").returncode == 6
    refused(tworelay("tune", "last"), 3, "no gain is proposed")
    refused(tworelay("plot", "loci", "last"), 3, "no locus")


def test_a_profile_that_does_not_know_its_loops_gets_gains_for_the_host_alone(
    tworelay: Tworelay, tmp_path: Path
) -> None:
    text = source_text("virtual-modbus")
    begin, end = text.index("[loops]"), text.index("# -- cyclic")
    profile = tmp_path / "mine.toml"
    profile.write_text(text[:begin] + text[end:])
    # virtual:// takes its own profile only by name, so the name stays
    done = tworelay("tune", "virtual://bench", "--profile", str(profile), "--yes", "--json", "-")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert {s["loop"] for s in result["tuning"]} == {"host"}
    assert "does not say their dead time; give --drive-dead-time" in done.stderr
    done = tworelay("tune", "last", "--drive-dead-time", "0.001", "--json", "-")
    again = json.loads(done.stdout)
    drive = sets_of(again, "drive", "corrected")["cascade"]
    assert drive["gains"]
    assert drive["parameters"] == [], "nothing is mapped"


def test_gains_outside_the_drive_s_range_are_said_and_not_proposed(
    tworelay: Tworelay, tmp_path: Path
) -> None:
    text = source_text("virtual-modbus").replace(
        "scale = 0.01\nmaximum = 1000000", "scale = 0.01\nmaximum = 100"
    )
    profile = tmp_path / "mine.toml"
    profile.write_text(text)
    done = tworelay("tune", "virtual://bench", "--profile", str(profile), "--yes", "--json", "-")
    assert done.returncode == 0, done.stderr
    found = sets_of(json.loads(done.stdout), "drive", "corrected")["cascade"]
    assert not found["proposed"]
    assert (found["why_not_code"], found["why_not"][:15]) == (
        "gains.out-of-range",
        "'position_gain'",
    )
    assert "is outside 0…1 1/s" in found["why_not"]


def test_a_point_beyond_the_cycle_gives_no_gains(
    tworelay: Tworelay,
) -> None:
    done = tworelay("tune", "virtual://bench?viscous=0.05", "--cycle", "0.02", "--watchdog", "0.3",
                    "--travel", "60", "--yes", "--json", "-")  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = sets_of(json.loads(done.stdout), "host", "corrected")["ziegler-nichols-pi"]
    assert found["gains"] == {}
    assert "is beyond a cycle of 20 ms" in found["why_not"]


def test_the_loci_are_drawn_beside_the_plant(
    tworelay: Tworelay, tuned: dict[str, Any], tmp_path: Path
) -> None:
    target = tmp_path / "loci.svg"
    done = tworelay("plot", "loci", tuned["run"], "--amplitude", "0.4", "--hysteresis", "0.02",
                    "--output", str(target))  # fmt: skip
    assert done.stdout.strip() == str(target), done.stderr
    text = target.read_text("utf-8")
    assert text.count("<svg") == 1
    assert (tmp_path / "home" / "runs").exists()
    refused(tworelay("plot", "loci", "last", "--output", "x.bmp"), 2, "must end with .svg")
    refused(tworelay("plot", "loci", "nosuch"), 2, "nosuch")


def test_a_run_of_the_thesis_method_knows_no_inertia_so_no_gain(tworelay: Tworelay) -> None:
    done = tworelay("identify", "virtual://bench", "--method", "two-relay", "--yes")
    assert done.returncode == 0, done.stderr
    refused(tworelay("tune", "last"), 3, "inertia and dead time could not be identified")


def changed(tworelay: Tworelay, folder: Path, change: Any) -> str:
    """The latest run, exported, with its JSON changed."""
    assert tworelay("export", "last", str(folder)).returncode == 0
    path = folder / "run.json"
    tree = json.loads(path.read_text())
    change(tree)
    path.write_text(json.dumps(tree))
    return str(folder)


def test_a_run_that_names_other_parameters_as_gains_writes_none(
    tworelay: Tworelay, tuned: dict[str, Any], tmp_path: Path
) -> None:
    def limits(tree: dict[str, Any]) -> None:
        for item in tree["tuning"]:
            if item["parameters"]:
                item["parameters"][0] |= {"parameter": "max_torque", "new_raw": 500}

    folder = changed(tworelay, tmp_path / "x", limits)
    other = {"TWORELAY_HOME": str(tmp_path / "other")}
    done = tworelay("adopt", folder, "--yes", environment=other)
    refused(done, 3, "'max_torque' has protection 'experiment' and is written as gain")
    own = home() / "runs" / tuned["run"] / "run.json"  # and where somebody changed it afterwards
    shutil.copy(f"{folder}/run.json", own)
    done = tworelay("apply", "last", "--gains", "cascade", "--yes")
    refused(done, 3, "not those that the profile")


@pytest.mark.parametrize(
    "damage",
    [
        lambda tree: tree["friction"].pop("coulomb"),
        lambda tree: tree["friction"]["inertia"].update(value=0.0),
        lambda tree: tree["friction"]["inertia"].update(value=-1.0),
        lambda tree: tree["experiment"].update(cycle=0.0),
        lambda tree: tree["experiment"]["setup"].update(resolution=0.0),
        lambda tree: tree["experiment"]["limits"].update(travel=0.0),
        lambda tree: tree["experiment"]["cycles"][0].update(relay_amplitude=0.0),
        lambda tree: tree["experiment"]["cycles"][0].update(period=0.0),
        lambda tree: tree["critical_point"]["naive"].update(gain=0.0),
        lambda tree: tree.pop("critical_point"),
        lambda tree: tree.update(tuning=[1]),
        lambda tree: tree.update(tuning=[{}]),
        lambda tree: tree["tuning"][-1]["parameters"][0].pop("new_raw"),
        lambda tree: tree["tuning"][-1]["parameters"][0].update(new_raw="abc"),
    ],
)
def test_a_damaged_run_is_one_plain_line_for_every_command(
    tworelay: Tworelay, tuned: dict[str, Any], tmp_path: Path, damage: Any
) -> None:
    folder = changed(tworelay, tmp_path / "x", damage)
    for command in (["tune", folder], ["plot", "loci", folder], ["report", folder],
                    ["apply", folder, "--gains", "cascade", "--yes"]):  # fmt: skip
        done = tworelay(*command)
        assert done.returncode in (0, 2, 3), (command, done.stderr)
        assert "internal error" not in done.stderr, command
    assert tuned["run"]


def test_a_run_of_an_earlier_version_has_its_report(
    tworelay: Tworelay, tuned: dict[str, Any], tmp_path: Path
) -> None:
    def older(tree: dict[str, Any]) -> None:
        tree["tuning"] = []
        tree["units"].pop("stiffness")
        tree["experiment"]["setup"] = None
        for key, point in tree["critical_point"].items():
            if key.startswith("at_") or key == "measured":
                tree["critical_point"][key] = None
            else:
                for name in ("gain_low", "gain_high", "phase_low_deg", "phase_high_deg"):
                    point.pop(name)

    folder = changed(tworelay, tmp_path / "x", older)
    done = tworelay("report", folder)
    assert done.returncode == 0, done.stderr
    refused(tworelay("tune", folder), 2, "identify the axis again")
    assert tuned["run"]


def test_the_json_is_written_when_tuning_is_refused_too(tworelay: Tworelay) -> None:
    done = tworelay("tune", "virtual://bench", "--method", "two-relay", "--yes", "--json", "-")
    assert done.returncode == 3
    result = json.loads(done.stdout)
    jsonschema.validate(result, SCHEMA)
    assert result["status"] == "refused"
    assert result["friction"]["coulomb"]["value"] == pytest.approx(0.1, rel=0.06)


def test_points_that_time_does_not_allow_leave_the_measurement_whole(tworelay: Tworelay) -> None:
    done = tworelay("tune", "virtual://emps", "--duration", "20", "--yes", "--json", "-")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["friction"]["coulomb"]["value"] == pytest.approx(20.39, rel=0.01)
    assert result["critical_point"]["at_135"]["how"] == "computed"
    assert any(
        "s are left of --duration" in reason["text"] for reason in result["quality"]["reasons"]
    )


def test_all_methods_give_one_limit_cycle_for_every_reading(tworelay: Tworelay) -> None:
    done = tworelay("identify", "virtual://bench", "--method", "all", "--yes", "--json", "-")
    points = json.loads(done.stdout)["critical_point"]
    assert points["naive"]["period"] == points["corrected"]["period"]


@pytest.mark.parametrize("axis", ["mx106", "bench?lag=0.0015", "tree", "epos-screw"])
def test_what_is_proposed_comes_to_rest_at_its_goal(tworelay: Tworelay, axis: str) -> None:
    done = tworelay("tune", f"virtual://{axis}", "--yes", "--json", "-")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    for item in result["tuning"]:
        if item["proposed"] and item["step"]:
            step = item["step"]
            assert step["settling"] is not None
            assert abs(step["error"]) + step["hunting"] < 0.1 * step["size"]
            assert step["overshoot"] < 0.5


def test_the_lag_of_the_drive_s_torque_loop_counts_in_its_own_loops(tworelay: Tworelay) -> None:
    sets = []
    for lag in ("0", "0.001"):
        done = tworelay("tune", f"virtual://bench?lag={lag}", "--yes", "--json", "-")
        sets.append(sets_of(json.loads(done.stdout), "drive", "corrected")["tyreus-luyben-pid"])
    ku = [1 / item["point"]["gain"] for item in sets]
    assert ku[0] > 5 * ku[1]


def test_gains_are_judged_as_the_drive_holds_them(tworelay: Tworelay, tmp_path: Path) -> None:
    coarse = source_text("virtual-modbus").replace(
        'title = "Velocity loop: integral time, 0: none"\nunit = "s"\nscale = 1e-6',
        'title = "Velocity loop: integral time, 0: none"\nunit = "s"\nscale = 0.05',
    )
    profile = tmp_path / "mine.toml"
    profile.write_text(coarse)
    done = tworelay("tune", "virtual://bench", "--profile", str(profile), "--yes", "--json", "-")
    found = sets_of(json.loads(done.stdout), "drive", "corrected")["cascade"]
    assert not found["proposed"]
    assert found["why_not_code"] == "gains.too-fine"
    assert found["why_not"].startswith("'integral_time' would be 0.0075")
    assert found["parameters"] == []


def test_options_of_a_measurement_do_not_go_with_a_run(
    tworelay: Tworelay, tuned: dict[str, Any]
) -> None:
    refused(tworelay("tune", tuned["run"], "--travel", "3"), 2, "--travel is for a TARGET")
    refused(tworelay("tune", tuned["run"], "--drive-period", "1e-7"), 2, "--drive-period")
    refused(tworelay("tune", tuned["run"], "--drive-dead-time", "0.09"), 2, "both in seconds")
