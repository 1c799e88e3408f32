"""Who may start beside whom: by brute force over random fleets, and by hand."""

from __future__ import annotations

import random
from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from commissioning.fleet.schedule import Rules, Task, makespan, planned, startable

BUSY = Rules(4, 4)


@st.composite
def fleets(draw: st.DrawFn) -> tuple[list[Task], Rules]:
    count = draw(st.integers(1, 12))
    tasks = []
    for n in range(count):
        after = draw(st.lists(st.integers(0, max(0, n - 1)), max_size=2)) if n else []
        tasks.append(
            Task(
                f"a{n}", draw(st.sampled_from(["", "bus1", "bus2"])),
                draw(st.sampled_from(["", "g", "h"])), draw(st.sampled_from(["", "z"])),
                tuple(f"a{m}" for m in set(after)), draw(st.floats(0.1, 10)), draw(st.booleans()),
            )
        )  # fmt: skip
    rules = Rules(draw(st.integers(1, 3)), draw(st.integers(3, 4)), {"z": draw(st.integers(1, 2))})
    return tasks, rules


@settings(max_examples=200, deadline=None)
@given(fleets(), st.integers(0, 2**32))
def test_no_token_is_taken_twice_and_all_come_to_their_turn(
    found: tuple[list[Task], Rules], seed: int
) -> None:
    tasks, rules = found
    draw = random.Random(seed)
    waiting = list(tasks)
    running: list[Task] = []
    done: list[str] = []
    while waiting or running:
        begun = startable(waiting, running, done, rules)
        waiting = [task for task in waiting if task not in begun]
        running += begun
        assert running, "somebody can always go on"
        for key in ("bus", "group"):
            taken = Counter(getattr(task, key) for task in running if getattr(task, key))
            assert all(count == 1 for count in taken.values())
        assert sum(task.zone == "z" for task in running) <= rules.zones["z"]
        assert sum(not task.stepping for task in running) <= rules.punctual
        assert len(running) <= max(rules.stepping, rules.punctual)
        assert all(set(task.after) <= set(done) for task in begun)
        ended = draw.choice(running)
        running.remove(ended)
        done.append(ended.name)


def test_the_longest_row_is_begun_first() -> None:
    """Four on one bus are what a run waits for: their bus goes first, then the longest alone."""
    tasks = [Task("short", seconds=1), Task("long", seconds=3)]
    tasks += [Task(f"b{n}", "bus", seconds=1) for n in range(4)]
    assert [task.name for task in startable(tasks, [], (), Rules(2, 2))] == ["b0", "long"]


def test_nothing_starts_in_a_paused_zone_or_beside_one_that_is_late() -> None:
    tasks = [Task("in", zone="z"), Task("out"), Task("simulated", stepping=True)]
    begun = startable(tasks, [], (), BUSY, paused={"z"})
    assert {task.name for task in begun} == {"out", "simulated"}
    late = startable(tasks, [], (), BUSY, late={""})
    assert {task.name for task in late} == {"simulated"}


@pytest.mark.parametrize(
    ("tasks", "rules", "seconds"),
    [
        ([Task("a", "bus", seconds=3), Task("b", "bus", seconds=2)], BUSY, 5),
        ([Task("a", seconds=3), Task("b", seconds=2)], BUSY, 3),
        ([Task("a", seconds=3), Task("b", seconds=2)], Rules(1, 1), 5),
        ([Task("a", seconds=3), Task("b", seconds=2, after=("a",))], BUSY, 5),
        ([Task(f"a{n}", "x" if n < 20 else "y", seconds=60) for n in range(40)], BUSY, 1200),
        ([Task("a", group="g", seconds=1), Task("b", group="g", seconds=1)], BUSY, 2),
        ([Task(f"a{n}", zone="z", seconds=1) for n in range(6)], Rules(9, 9, {"z": 2}), 3),
        ([], BUSY, 0),
        ([Task("a", seconds=1, after=("gone",))], BUSY, 1),
    ],
)
def test_how_long_it_takes(tasks: list[Task], rules: Rules, seconds: float) -> None:
    assert makespan(tasks, {}, rules) == pytest.approx(seconds)


def test_what_runs_holds_its_tokens_until_it_ends() -> None:
    running = {Task("a", "bus"): 2.5}
    assert makespan([Task("b", "bus", seconds=1)], running, BUSY) == pytest.approx(3.5)


def test_the_order_is_that_of_the_run() -> None:
    tasks = [Task("short", seconds=1), Task("last", seconds=1, after=("b1",))]
    tasks += [Task(f"b{n}", "bus", seconds=2) for n in range(2)]
    assert planned(tasks, {}, Rules(2, 2)) == {"b0": 0.0, "short": 0.0, "b1": 2.0, "last": 4.0}
