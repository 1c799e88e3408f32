"""Which oscillations fit the room that there is, and what a refusal names."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from commissioning.experiments.design import design
from commissioning.experiments.first_look import FirstLook
from commissioning.experiments.plan import Context
from commissioning.experiments.stopping import Stopping
from drivers.errors import PreflightRefused

KNOWN = FirstLook(
    breakaway=0.1, offset=0.0, coulomb=0.1, viscous=2e-3, inertia=1e-3, dead_time=2e-3
)
ROOM = Context(cycle=2e-3, resolution=5e-5, start=0.0, travel=20.0, torque=1.0, speed=300.0)
STOPPING = Stopping(1e-3, 0.1, 0.3, reaction=0.056, delay=6e-3, watchdog=0.05)


def test_a_pair_that_fits_stops_within_the_travel() -> None:
    found = design(ROOM, KNOWN, STOPPING)
    assert found.d1 == pytest.approx(0.17)  # 1.7 times the friction
    assert found.d2 == pytest.approx(1.8 * 0.17)
    assert STOPPING.distance(0.0, found.d2) < ROOM.travel


@pytest.mark.parametrize(
    ("context", "stopping", "option"),
    [
        (replace(ROOM, travel=0.3), STOPPING, "travel"),
        (replace(ROOM, travel=0.3), STOPPING, "watchdog"),
        (replace(ROOM, speed=0.5), STOPPING, "max-speed"),
    ],
)
def test_a_refusal_names_what_would_do(context: Context, stopping: Stopping, option: str) -> None:
    with pytest.raises(PreflightRefused) as caught:
        design(context, KNOWN, stopping)
    found = re.search(rf"--{option} ([\d.]+)", str(caught.value))
    assert found is not None, str(caught.value)
    value = float(found[1])
    if option == "watchdog":
        stopping = replace(stopping, reaction=stopping.delay + value, watchdog=value)
    else:
        context = replace(context, **{"travel" if option == "travel" else "speed": value})
    assert design(context, KNOWN, stopping).period > 8 * context.cycle


def test_where_this_computer_notices_a_dead_link_the_cycle_is_named() -> None:
    slow = replace(STOPPING, watchdog=0.0)
    with pytest.raises(
        PreflightRefused, match=r"a dead link is noticed after 50 ms, .* a shorter --cycle"
    ):
        design(replace(ROOM, travel=0.3), KNOWN, slow)
