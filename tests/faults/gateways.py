"""Gateways, their clients, their processes and the wires between them fail in every way: `make
gateway-faults`. No axis is started twice for one grant, and each is accounted for.

Here nothing is a process and time is simulated; then the network is cut with real ones, in
`tests.faults.gateways_real`.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from commissioning.desk import Options
from commissioning.fleet.file import Keys
from commissioning.fleet.gateway.messages import PROTOCOL, Ask, Offered, Start, Work
from commissioning.fleet.ledger import Ledger
from commissioning.fleet.messages import Order
from commissioning.result.fleet import FAILED, FleetResult, JobState
from commissioning.result.fleet_codec import json_of, of_json
from profiles.errors import Refused
from tests.faults.gateways_real import CUTS
from tests.gateways.world import Client, ClientDied, Gateway, Trouble, World

__all__ = ["CASES", "Case", "held", "order_of"]

YEAR = 366 * 86400.0
AXES = {"pc-a": ["x", "y"], "pc-b": ["z"]}
_SETTLES = 120.0  # s in which everything ends that was begun


@dataclass(frozen=True)
class Case:
    """One thing that goes wrong."""

    name: str
    act: Callable[[World], None]


# -- what is common to all ------------------------------------------------------------------------


def _finish(world: World, *clients: Client) -> None:
    """Everything comes back; what was left is resumed; then all is done, or has failed and why."""
    world.troubles = []
    for gateway in world.gateways.values():
        gateway.frozen.set()
        if gateway.station is None:
            gateway.start()
    world.go_on(_SETTLES)
    for client in clients:
        if not client.run_id:
            continue
        for _ in range(4):
            with contextlib.suppress(_StillUnderWay):
                _taken_up(client)
                break
            world.go_on(_SETTLES)
        world.check(client)
        for axis, (attempt, state) in client.states().items():
            assert state is JobState.DONE or state in FAILED, f"'{axis}' is left {state}"
            if state in (JobState.DONE, JobState.STOPPED):
                gateway = next(g for g in world.gateways.values() if axis in _axes_of(g))
                there = gateway.going(client.key, axis, attempt)
                assert there.state is state, f"'{axis}' is {state}, and {there.state} there"


class _StillUnderWay(Exception):
    """A gateway says that it moves one of the axes."""


def _taken_up(client: Client) -> None:
    try:
        client.run(take_up=True)
    except Refused as refused:
        if "under way" in refused.text:
            raise _StillUnderWay from None
        raise


def _axes_of(gateway: Gateway) -> list[str]:
    return AXES[gateway.name]


def _run(client: Client, at: Callable[[int, FleetResult], None] | None = None) -> None:
    """A run; a client that dies is a client that died."""
    with contextlib.suppress(ClientDied):
        client.run(at=at or (lambda n, result: None))


# -- the wire -------------------------------------------------------------------------------------


def _wire(world: World, verb: str, number: int, does: str, late: float, outage: float) -> None:
    world.troubles = [Trouble(verb, number, does, late, outage)]
    client = world.client()
    _run(client)
    begun = sum(world.moved.values())
    world.go_on(_SETTLES)
    assert sum(world.moved.values()) == begun, "something begins after it was given up"
    _finish(world, client)


def _wire_cases() -> Iterator[Case]:
    ways = [
        (does, 0.0, outage)
        for does in ("before", "after", "twice", "hang") for outage in (0.0, 10.0, 100.0)
    ]  # fmt: skip
    ways += [("late", late, outage) for late in (2.0, 20.0, 35.0, 70.0) for outage in (0.0, 100.0)]
    for verb, number in (("look", 1), ("offer", 1), ("offer", 2), ("start", 1), ("start", 2)):
        for does, late, outage in ways:
            name = (
                f"{verb} {number}: {does}{f' {late:.0f} s' if late else ''}, out for {outage:.0f} s"
            )
            yield Case(name, partial(_wire, verb=verb, number=number, does=does, late=late,
                                     outage=outage))  # fmt: skip
    for number, (does, outage) in itertools.product(
        (1, 5, 20, 60), (("before", 0.0), ("after", 10.0), ("hang", 100.0))
    ):
        yield Case(
            f"news {number}: {does}, out for {outage:.0f} s",
            partial(_wire, verb="news", number=number, does=does, late=0.0, outage=outage),
        )


def _settling(world: World, does: str, late: float, outage: float) -> None:
    world.troubles = [Trouble("start", 1, "after"), Trouble("settle", 1, does, late, outage)]
    client = world.client()
    _run(client)
    _finish(world, client)


def _settle_cases() -> Iterator[Case]:
    for does, late, outage in (
        ("before", 0.0, 0.0), ("after", 0.0, 10.0), ("twice", 0.0, 0.0), ("late", 30.0, 100.0),
        ("hang", 0.0, 100.0),
    ):  # fmt: skip
        yield Case(
            f"start unanswered, then settle: {does}, out for {outage:.0f} s",
            partial(_settling, does=does, late=late, outage=outage),
        )


# -- computers and processes ----------------------------------------------------------------------

PHASES = {"looking": 0.1, "offering": 0.45, "granted": 0.75, "moving": 3.0, "ending": 6.95}  # s


def _gateway_dies(world: World, when: float, back: float) -> None:
    gateway = world.gateways["pc-a"]
    world.after(when, gateway.die)
    world.after(when + back, lambda: None if gateway.station else gateway.start())
    client = world.client()
    _run(client)
    _finish(world, client)


def _gateway_is_ended(world: World, when: float, back: float) -> None:
    """As by SIGTERM: nothing more starts, what moves is stopped, and then it is gone."""
    gateway = world.gateways["pc-a"]

    def end() -> None:
        if gateway.station is not None:
            gateway.station.is_closing = True
            gateway.station.interrupt()

    world.after(when, end)
    world.after(when + 1.0, gateway.die)
    world.after(when + 1.0 + back, lambda: None if gateway.station else gateway.start())
    client = world.client()
    _run(client)
    _finish(world, client)


def _gateway_freezes(world: World, when: float, back: float) -> None:
    gateway = world.gateways["pc-a"]
    world.after(when, gateway.frozen.clear)
    world.after(when + back, gateway.frozen.set)
    client = world.client()
    _run(client)
    _finish(world, client)


def _process_dies(world: World, when: float, *, all_of_them: bool) -> None:
    gateway = world.gateways["pc-a"]

    def kill() -> None:
        for process in gateway.crew.all[: None if all_of_them else 1]:
            process.kill()

    world.after(when, kill)
    client = world.client()
    _run(client)
    world.check(client)
    _finish(world, client)


def _all_dies(world: World, when: float) -> None:
    """The computer of the gateway loses power."""
    gateway = world.gateways["pc-a"]

    def cut() -> None:
        for process in list(gateway.crew.all):
            process.kill()
        gateway.die()

    world.after(when, cut)
    world.after(when + 30.0, lambda: None if gateway.station else gateway.start())
    client = world.client()
    _run(client)
    _finish(world, client)


def _computer_cases() -> Iterator[Case]:
    for phase, back in itertools.product(PHASES, (1.0, 20.0, 100.0)):
        when = PHASES[phase]
        for what, act in (
            ("is killed", _gateway_dies), ("is ended", _gateway_is_ended),
            ("freezes", _gateway_freezes),
        ):  # fmt: skip
            yield Case(
                f"gateway {what} while {phase}, back after {back:.0f} s",
                partial(act, when=when, back=back),
            )
    for phase, when in PHASES.items():
        yield Case(
            f"process dies while {phase}", partial(_process_dies, when=when, all_of_them=False)
        )
        yield Case(f"all processes die while {phase}",
                   partial(_process_dies, when=when, all_of_them=True))  # fmt: skip
        yield Case(f"computer loses power while {phase}", partial(_all_dies, when=when))


# -- clients --------------------------------------------------------------------------------------


def _client_dies(world: World, number: int, pause: float, *, is_cut: bool) -> None:
    """At its n-th picture; then it is taken up again."""

    def at(n: int, result: FleetResult) -> None:
        if n == number:
            raise ClientDied

    client = world.client()
    _run(client, at)
    if is_cut:
        for gateway in world.gateways.values():
            world.cut(gateway, 10.0)
    begun = sum(world.moved.values())
    world.go_on(pause)
    moving = sum(world.moved.values()) - begun
    assert moving <= 3, "something new began without a client"
    _finish(world, client)


def _client_is_stopped(world: World, number: int, does: str, outage: float) -> None:
    world.troubles = [Trouble("stop", 1, does, outage=outage)]
    client = world.client()

    def at(n: int, result: FleetResult) -> None:
        if n == number:
            client.interruption.count, client.interruption.signal = 2, 2

    _run(client, at)
    assert client.people is not None
    told = " ".join(client.people.told)
    is_moving = any(state is JobState.STOPPED for _, state in client.states().values())
    if outage > 5.0 and is_moving:
        assert "NOT VERIFIED" in told, told
    _finish(world, client)


def _stopped_while_it_is_offered(world: World) -> None:
    """Its answer is lost, and it is offered again after the stop: nothing starts."""
    client = world.client()

    def stop() -> None:
        client.interruption.count, client.interruption.signal = 2, 2

    world.troubles = [Trouble("offer", 1, "after", then=stop), Trouble("offer", 2, "before")]
    _run(client)
    assert not world.moved, "something starts after a stop"
    _finish(world, client)


def _two_clients(world: World, number: int) -> None:
    """Both are for the same axes; the second comes at the n-th picture of the first."""
    first, second = world.client("one"), world.client("two")

    def at(n: int, result: FleetResult) -> None:
        if n == number:
            second.run()

    _run(first, at)
    world.check(first, second)
    assert sum(world.moved.values()) >= 3, "neither has done it"
    _finish(world, first, second)


def _client_cases() -> Iterator[Case]:
    for number, pause, is_cut in itertools.product(
        (1, 2, 3, 4, 6, 9, 14), (0.0, 30.0), (False, True)
    ):
        yield Case(
            f"client dies at picture {number}, is back after {pause:.0f} s"
            f"{', with the wire cut' if is_cut else ''}",
            partial(_client_dies, number=number, pause=pause, is_cut=is_cut),
        )
    for number, (does, outage) in itertools.product(
        (3, 5, 8, 16),
        (("pass", 0.0), ("before", 0.0), ("after", 0.0), ("before", 20.0), ("hang", 0.0)),
    ):
        yield Case(
            f"stopped at picture {number}, and the stop: {does}, out for {outage:.0f} s",
            partial(_client_is_stopped, number=number, does=does, outage=outage),
        )
    yield Case("stopped while it is offered", _stopped_while_it_is_offered)
    for number in (1, 2, 3, 5, 8, 12):
        yield Case(f"a second client at picture {number}", partial(_two_clients, number=number))


# -- words: nonces, calendars, versions, files ----------------------------------------------------


def _order(world: World, axis: str) -> Order:
    return order_of(next(g for g in world.gateways.values() if axis in _axes_of(g)), axis)


def order_of(gateway: Gateway, axis: str) -> Order:
    """A job on an axis as its gateway describes it."""
    assert gateway.station is not None
    said = gateway.station._folder.axis(axis, Keys()).as_said()
    return Order("job", "r", axis, 1, "identify", said, Options())


def _offered(world: World, gateway: Gateway, axis: str, run: str = "r@host-1") -> Start:
    assert gateway.station is not None
    answer = gateway.station.handle("offer", json_of(Work(run, _order(world, axis))))
    assert answer.startswith("+"), answer
    return Start(of_json(answer[1:], Offered).nonce)


def _started(gateway: Gateway, start: Start) -> bool:
    assert gateway.station is not None
    return gateway.station.handle("start", json_of(start)).startswith("+")


def _same_nonce_twice(world: World) -> None:
    gateway = world.gateways["pc-a"]
    start = _offered(world, gateway, "x")
    assert [_started(gateway, start) for _ in range(3)] == [True, False, False]
    world.go_on(20)
    assert world.moved == {("r@host-1", "x", 1): 1}


def _late_nonce(world: World, seconds: float) -> None:
    gateway = world.gateways["pc-a"]
    start = _offered(world, gateway, "x")
    world.go_on(seconds)
    assert _started(gateway, start) is (seconds < 30.0)
    world.go_on(20)
    assert sum(world.moved.values()) == (seconds < 30.0)


def _nonce_of_an_earlier_life(world: World) -> None:
    gateway = world.gateways["pc-a"]
    start = _offered(world, gateway, "x")
    gateway.die()
    gateway.start()
    assert not _started(gateway, start)
    world.go_on(20)
    assert not world.moved


def _two_nonces_for_one_attempt(world: World) -> None:
    gateway = world.gateways["pc-a"]
    starts = [_offered(world, gateway, "x") for _ in range(2)]
    assert [_started(gateway, start) for start in starts].count(True) == 1
    world.go_on(20)
    assert world.moved == {("r@host-1", "x", 1): 1}


def _settled_before_it_started(world: World) -> None:
    gateway = world.gateways["pc-a"]
    start = _offered(world, gateway, "x")
    assert gateway.going("r@host-1", "x", 1).state is JobState.REVOKED
    assert not _started(gateway, start)
    world.go_on(20)
    assert not world.moved


def _axis_file_changes(world: World, *, after_offer: bool) -> None:
    """Between what was confirmed and what would be moved; the refusal says which key."""
    gateway = world.gateways["pc-a"]
    assert gateway.station is not None
    order = _order(world, "x")
    start = _offered(world, gateway, "x") if after_offer else None
    with (gateway.folder / "x.toml").open("a") as file:
        file.write("[limits]\nspeed = 1.5\n")
    verb, asked = ("start", json_of(start)) if start else ("offer", json_of(Work("r", order)))
    answer = gateway.station.handle(verb, asked)
    assert answer.startswith("-"), answer
    assert "limits" in answer, answer
    world.go_on(20)
    assert not world.moved


def _calendars(world: World, skew: float, pause: float) -> None:
    world.gateways["pc-a"].skew = skew
    client = world.client()

    def at(n: int, result: FleetResult) -> None:
        if n == 6 and pause:
            raise ClientDied

    _run(client, at)
    world.gateways["pc-b"].skew = -skew
    world.go_on(pause)
    _finish(world, client)
    assert all(state is JobState.DONE for _, state in client.states().values()), client.states()


def _versions(world: World, text: str) -> None:
    """A client of other messages, or of another world, is refused in one line."""
    gateway = world.gateways["pc-a"]
    assert gateway.station is not None
    answer = gateway.station.handle("hello", text)
    assert answer.startswith("-"), answer
    assert "Traceback" not in answer
    client = world.client()
    _run(client)
    _finish(world, client)


def _word_cases() -> Iterator[Case]:
    yield Case("the same nonce three times", _same_nonce_twice)
    for seconds in (29.0, 31.0, 3600.0):
        yield Case(f"a nonce after {seconds:.0f} s", partial(_late_nonce, seconds=seconds))
    yield Case("a nonce of an earlier life", _nonce_of_an_earlier_life)
    yield Case("two nonces for one attempt", _two_nonces_for_one_attempt)
    yield Case("settled before it was started", _settled_before_it_started)
    for after_offer in (False, True):
        yield Case(
            f"the axis file changes {'after' if after_offer else 'before'} the offer",
            partial(_axis_file_changes, after_offer=after_offer),
        )
    for skew, pause in itertools.product((YEAR, -YEAR, 30 * YEAR), (0.0, 60.0)):
        yield Case(
            f"calendars {skew / YEAR:.0f} years apart, client away for {pause:.0f} s",
            partial(_calendars, skew=skew, pause=pause),
        )
    asks = {
        "newer": json_of(Ask(PROTOCOL + 1, "9.9")), "older": json_of(Ask(0, "0.0.1")),
        "words that are not known": '{"protocol": "one"}', "no JSON": "hello?",
    }  # fmt: skip
    for what, text in asks.items():
        yield Case(f"a client of other messages: {what}", partial(_versions, text=text))


CASES: Sequence[Case] = (
    *_wire_cases(), *_settle_cases(), *_computer_cases(), *_client_cases(), *_word_cases(),
)  # fmt: skip


def held(case: Case) -> str:
    """'' or why it did not hold."""
    place = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryDirectory(dir=place) as folder:
        world = World(Path(folder), AXES)
        try:
            case.act(world)
            world.check()
            for gateway in world.gateways.values():
                with Ledger(gateway.home, reading=True) as ledger:
                    assert not ledger.moving(), "something moves still"
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            return f"{type(error).__name__}: {error} ({Path(where.filename).name}:{where.lineno})"
        finally:
            world.close()
    return ""


def _numbered(number: int) -> tuple[int, str]:
    return number, held(CASES[number])


def _real(numbers: Sequence[int]) -> Iterator[tuple[str, str]]:
    """Cuts of the network, with the engine in a process of its own; and why they did not hold."""
    words = [sys.executable, "-m", "tests.faults.gateways_real", *map(str, numbers)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        told = 0
        for line in process.stdout:
            told += 1
            yield line[2:].strip(), "" if line.startswith("+") else line[2:].strip()
        for number in numbers[told:]:
            yield str(CUTS[number]), f"{CUTS[number]}: its process has ended"


def main() -> int:
    """`gateways [PART/PARTS]`: the last line is `gateway faults: N cases, M held`."""
    words = [word.split("/") for word in sys.argv[1:] if "/" in word]
    part, parts = map(int, words[0]) if words else (1, 1)
    chosen = range(len(CASES))[part - 1 :: parts]
    cuts = range(len(CUTS))[part - 1 :: parts]
    total = len(chosen) + len(cuts)
    begun, good, count = time.monotonic(), 0, 0

    def tell(name: str, why: str) -> None:
        nonlocal good, count
        good, count = good + (not why), count + 1
        if why:
            sys.stdout.write(f"  {name}: {why}\n")
        if count % 50 == 0:
            left = (time.monotonic() - begun) / count * (total - count)
            sys.stdout.write(f"{count} of {total}, {left / 60:.1f} min left\n")
        sys.stdout.flush()

    with get_context("spawn").Pool(os.cpu_count()) as pool:
        for number, why in pool.imap_unordered(_numbered, chosen):
            tell(CASES[number].name, why)
    for name, why in _real(cuts):
        tell(name, why)
    sys.stdout.write(f"{(time.monotonic() - begun) / 60:.1f} min\n")
    sys.stdout.write(f"gateway faults: {count} cases, {good} held\n")
    return 0 if good == count == total else 1


if __name__ == "__main__":
    sys.exit(main())
