"""Clients and gateways in simulated time: stops, groups, doubts, two of them at once."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from commissioning.fleet.gateway.messages import Offered, Start, Work
from commissioning.fleet.stopping import stop_runs
from commissioning.result.fleet import FleetResult, JobState
from commissioning.result.fleet_codec import json_of, of_json
from drivers.errors import LinkError
from tests.faults.gateways import order_of
from tests.gateways.world import Client, ClientDied, World

AXES = {"pc-a": ["x"], "pc-b": ["y"]}


@pytest.fixture
def world(tmp_path: Path) -> Iterator[World]:
    found = World(tmp_path, AXES, lasts=60.0)
    yield found
    found.close()


def left_alone(client: Client, world: World) -> None:
    """A run whose client dies while all its axes move."""

    def at(number: int, result: FleetResult) -> None:
        if result.count(JobState.STARTED) == 2:
            raise ClientDied

    with pytest.raises(ClientDied):
        client.run(at=at)
    assert len(world.moved) == 2


def stop(client: Client) -> list[str]:
    return list(stop_runs(client.home, client.run_id, client.reach, drain=False))


def signals(world: World, gateway: str) -> list[int]:
    return [process.signals for process in world.gateways[gateway].crew.all]


def test_a_stop_reaches_the_others_where_one_gateway_is_silent(world: World) -> None:
    client = world.client()
    left_alone(client, world)
    world.cut(world.gateways["pc-a"], 1e6)
    with pytest.raises(LinkError, match=r"NOT VERIFIED.*'x'") as error:
        stop(client)
    assert "'y'" not in error.value.text
    world.go_on(1.0)
    assert signals(world, "pc-a") == [0]
    assert client.states()["y"][1] is JobState.STOPPED


def test_a_stop_does_not_need_the_file(world: World) -> None:
    client = world.client()
    left_alone(client, world)
    client.path.write_text("this is no TOML [")
    assert any("confirmed" in line for line in stop(client))
    assert {state for _, state in client.states().values()} == {JobState.STOPPED}


def test_a_stop_that_is_sent_twice_is_one(world: World) -> None:
    """A second one would mean: without waiting for rest."""
    gateway = world.gateways["pc-a"]
    client = world.client()
    left_alone(client, world)
    assert gateway.station is not None
    asked = json_of({"run": client.key, "request": "r1", "axis": ""})
    assert [gateway.station.handle("stop", asked) for _ in range(3)]
    assert signals(world, "pc-a") == [1]
    gateway.station.handle("stop", asked.replace("r1", "r2"))
    assert signals(world, "pc-a") == [2]


def test_a_run_beside_a_gateway_that_says_nothing(world: World) -> None:
    """What it may still move keeps the group of that axis and its zone from moving."""
    text = world.text.replace('name = "x"', 'name = "x"\ngroup = "g"').replace(
        'name = "y"', 'name = "y"\ngroup = "g"'
    )
    client = Client(world, "laptop", text + "[groups.g]\n")
    with pytest.raises(ClientDied):
        client.run(at=_dies_when_started)
    world.cut(world.gateways["pc-a"], 1e6)
    result = client.run()
    assert {one.name: one.state for one in result.axes}["y"] is JobState.BLOCKED
    assert len(world.moved) == 1


def _dies_when_started(number: int, result: FleetResult) -> None:
    if result.count(JobState.STARTED):
        raise ClientDied


def test_a_group_of_the_file_on_the_gateway_counts(tmp_path: Path) -> None:
    world = World(tmp_path, {"pc-a": ["x"], "pc-b": ["y"]})
    for gateway in world.gateways.values():
        for path in gateway.folder.glob("*.toml"):
            path.write_text(path.read_text() + 'group = "gantry"\n')
    client = Client(world, "laptop", world.text + "[groups.gantry]\n")
    most = 0

    def at(number: int, result: FleetResult) -> None:
        nonlocal most
        most = max(most, result.count(JobState.STARTED, JobState.GRANTED))

    result = client.run(at=at)
    assert result.count(JobState.DONE) == 2
    assert most == 1
    undeclared = Client(world, "other", world.text)
    assert undeclared.run().count(JobState.REFUSED) == 2
    world.close()


@pytest.mark.parametrize("between", [0.0, 0.1, 0.5])
def test_two_clients_at_one_gateway(tmp_path: Path, between: float) -> None:
    """The second is refused also while the process of the first is only just being started."""
    world = World(tmp_path, {"pc-a": ["x", "y"]}, lasts=60.0)
    gateway = world.gateways["pc-a"]
    station = gateway.station
    assert station is not None

    def begun(run: str, axis: str) -> bool:
        answer = station.handle("offer", json_of(Work(run, order_of(gateway, axis))))
        if answer.startswith("-"):
            return False
        nonce = of_json(answer[1:], Offered).nonce
        return station.handle("start", json_of(Start(nonce))).startswith("+")

    assert begun("one@a-1", "x")
    world.go_on(between)
    assert not begun("two@b-1", "y")
    world.go_on(3.0)
    assert dict(world.moved) == {("one@a-1", "x", 1): 1}
    world.close()
