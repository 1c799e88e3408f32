"""Every night: does commissioning still work, and does it still find what is there?

`pip install tworelay pytest`, then `pytest`: the fixtures come with tworelay.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest


def test_the_press_has_the_friction_that_it_was_built_with(
    press: Any, tworelay: Callable[..., Any]
) -> None:
    done = tworelay("identify", press.link, "--travel", "3", "--yes").check()
    friction = done.result["friction"]["coulomb"]
    assert friction["low"] < 0.14 < friction["high"]


def test_its_compensation_helps(press: Any, tworelay: Callable[..., Any]) -> None:
    done = tworelay("commission", press.link, "--travel", "3", "--yes").check()
    assert done.result["verification"]["percent"] > 50
    tworelay("restore", "--yes").check()


def test_too_much_friction_is_told(
    virtual_drive: Callable[..., Any], tworelay: Callable[..., Any]
) -> None:
    stuck = virtual_drive("bench?coulomb=2.5")
    done = tworelay("identify", stuck.link, "--travel", "3", "--yes").check(6)
    assert done.result["error"]["code"] == "measurement.no-motion"


def test_the_axis_as_it_was_measured(
    press: Any, virtual_drive: Callable[..., Any], tworelay: Callable[..., Any]
) -> None:
    run = tworelay("identify", press.link, "--travel", "3", "--yes").check().result["run"]
    twin = virtual_drive(run=run)
    again = tworelay("identify", twin.link, "--travel", "3", "--yes").check().result
    assert again["friction"]["coulomb"]["value"] == pytest.approx(0.14, rel=0.01)


@pytest.mark.fleet("line.toml")
def test_each_axis_of_the_line(fleet_axis: Any, tworelay: Callable[..., Any]) -> None:
    words = "fleet", "run", fleet_axis.fleet, "--only", fleet_axis.name, "--yes"
    done = tworelay(*words).check()
    (axis,) = [one for one in done.result["axes"] if one["name"] == fleet_axis.name]
    assert axis["outcome"]["verdict"] == "good"
