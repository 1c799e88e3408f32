"""What becomes of a fleet run: groups, zones, confirmations, interruptions; without a process."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from commissioning.errors import Interrupted, JournalError
from commissioning.fleet.messages import Report
from commissioning.fleet.people import Answer
from commissioning.fleet.taking_up import again, resume
from commissioning.journal import Journal
from commissioning.records import RunContext
from commissioning.result.endings import Error
from commissioning.result.fleet import FAILED, FleetState, JobState, Outcome
from drivers.home import home
from tests.fleet.crew import Stage, failed, good

YES, NO = Answer.YES, Answer.NO
MakeStage = Callable[[str], Stage]
HEAD = 'job = "commission"\nconfirm = "{0}"\n'


def text(axes: str, more: str = "", confirm: str = "group", keys: str = "") -> str:
    """Axes by their letters; `keys`: lines for each, with its letter for *."""
    lines = HEAD.format(confirm) + more
    for n, name in enumerate(axes, 1):
        lines += f'[[axes]]\nname = "{name}"\nlink = "virtual://bench?seed={n}"\n'
        lines += keys.replace("*", name)
    return lines


@pytest.fixture
def stage(tmp_path: Path, state_folder: Path) -> Iterator[MakeStage]:
    made: list[Stage] = []

    def make(fleet: str) -> Stage:
        made.append(Stage(tmp_path, fleet, state_folder))
        return made[-1]

    yield make
    for one in made:
        one.ledger.close()


def test_all_done_is_zero(stage: MakeStage) -> None:
    one = stage(text("abc"))
    result = one.run()
    assert (result.exit_code, result.state) == (0, FleetState.FINISHED)
    assert set(one.states().values()) == {"done"}


@pytest.mark.parametrize("state", sorted(FAILED))
def test_one_that_fails_stops_its_group_and_not_the_run(stage: MakeStage, state: JobState) -> None:
    one = stage(
        text("ab", "[groups.g]\n", keys='group = "g"\n')
        + '[[axes]]\nname = "c"\nlink = "virtual://bench?seed=9"\n'
    )
    one.does["a"] = failed(state)
    result = one.run()
    assert one.states() == {"a": str(state), "b": "blocked", "c": "done"}
    assert result.exit_code == 9
    assert "'a' of its group 'g'" in next(x.why for x in result.axes if x.name == "b")


def test_a_group_may_go_on(stage: MakeStage) -> None:
    one = stage(text("ab", '[groups.g]\non_failure = "go-on"\n', keys='group = "g"\n'))
    one.does["a"] = failed(JobState.FAULT)
    one.run()
    assert one.states() == {"a": "fault", "b": "done"}


def test_what_is_to_run_after_one_that_is_not_done_is_blocked(stage: MakeStage) -> None:
    one = stage(text("a") + "".join(
        f'[[axes]]\nname = "{name}"\nlink = "virtual://bench?seed=9{n}"\nafter = ["a"]\n'
        for n, name in enumerate("bc")
    ))  # fmt: skip
    one.does["a"] = failed(JobState.REJECTED)
    one.run()
    assert one.states() == {"a": "rejected", "b": "blocked", "c": "blocked"}


def test_a_look_that_is_refused_blocks_the_group_before_it_moves(stage: MakeStage) -> None:
    one = stage(text("ab", "[groups.g]\n", keys='group = "g"\n'))
    one.seen["b"] = Error("preflight.fault", "in fault")
    one.run()
    assert one.states() == {"a": "blocked", "b": "refused"}
    assert one.crew.orders == []


def test_an_unfinished_journal_blocks_its_axis(stage: MakeStage) -> None:
    one = stage(text("ab"))
    one.seen["a"] = Error("run.cut-off", "run r on this drive was cut off")
    one.run()
    assert one.states() == {"a": "blocked", "b": "done"}


# -- confirmations --------------------------------------------------------------------------------


def test_one_word_for_a_group_and_one_for_each_without(stage: MakeStage) -> None:
    one = stage(
        text("ab", "[groups.g]\n", keys='group = "g"\n')
        + '[[axes]]\nname = "c"\nlink = "virtual://bench?seed=9"\n'
    )
    one.in_advance = None
    one.people.answers = {"g": YES, "c": NO}
    one.run()
    assert [word for word, _ in one.people.asked] == ["g", "c"]
    question = one.people.asked[0][1]
    assert "'a' up to ±3 rad" in question
    assert "'b' up to ±3 rad" in question
    assert "not a safety function" in question
    assert one.states() == {"a": "done", "b": "done", "c": "refused"}
    (row,) = [r for r in one.ledger.rows(one.run_id).values() if r.axis == "a"]
    assert row.confirmed is not None
    assert row.confirmed.how == "'g' was typed"
    assert row.confirmed.room.travel == 3.0


def test_each_is_asked_for_alone(stage: MakeStage) -> None:
    one = stage(text("ab", "[groups.g]\n", "each", 'group = "g"\n'))
    one.in_advance = None
    one.people.answers = {"a": YES, "b": YES}
    one.run()
    assert [word for word, _ in one.people.asked] == ["a", "b"]


def test_what_starts_later_than_a_quarter_of_an_hour_is_asked_for_again(
    stage: MakeStage,
) -> None:
    one = stage(text("ab", "[groups.g]\n", keys='group = "g"\n'))
    one.in_advance = None
    one.people.answers = {"g": YES, "b": YES}
    one.does["a"] = []

    def end() -> None:
        one.now += 901
        one.crew.say("a", *good())

    one.steps[20] = end
    one.run()
    assert [word for word, _ in one.people.asked] == ["g", "b"]
    assert one.states() == {"a": "done", "b": "done"}


def test_while_nobody_answers_what_runs_goes_on(stage: MakeStage) -> None:
    one = stage(text("ab"))
    one.in_advance = None
    one.people.answers = {"a": YES}

    def answer() -> None:
        assert one.states()["a"] == "done"
        one.people.answers["b"] = YES

    one.steps[100] = answer
    one.run()
    assert one.states() == {"a": "done", "b": "done"}


# -- the emergency stop ---------------------------------------------------------------------------

ZONE = "[zones.z]\n"


def test_an_emergency_stop_pauses_its_zone_until_a_word_is_typed(stage: MakeStage) -> None:
    one = stage(text("ab", ZONE, keys='zone = "z"\n') + '[[axes]]\nname = "c"\n'
                'link = "virtual://bench?seed=9"\nafter = ["a"]\n')  # fmt: skip
    one.at_once = 1
    one.does["a"] = failed(JobState.FAULT, "drive.left")
    one.in_advance = None
    one.people.answers = {"a": YES, "z": YES, "b": YES}
    result = one.run()
    words = [word for word, _ in one.people.asked]
    assert words.index("z") > words.index("a")
    assert words.index("b") > words.index("z"), "what was seen before is not what is there now"
    assert one.states() == {"a": "fault", "b": "done", "c": "blocked"}
    assert any("paused" in line for line in one.people.told)
    assert result.exit_code == 9


def test_one_question_at_a_time(stage: MakeStage) -> None:
    """A zone is paused while another axis is asked for: its own question waits for its turn."""
    one = stage(
        text("ab", ZONE, keys='zone = "z"\n')
        + '[[axes]]\nname = "c"\nlink = "virtual://bench?seed=9"\n'
    )
    one.in_advance = None
    one.at_once = 2
    one.people.answers = {"a": YES}
    one.does["a"] = []
    one.steps[20] = lambda: one.crew.say("a", *failed(JobState.FAULT, "drive.left"))

    def answer() -> None:
        one.people.answers |= {"b": YES, "c": YES, "z": YES}

    one.steps[60] = answer
    one.run()
    assert one.states() == {"a": "fault", "b": "done", "c": "done"}
    assert [word for word, _ in one.people.asked].count("z") == 1


def test_without_a_terminal_a_paused_zone_ends_the_run(stage: MakeStage) -> None:
    one = stage(text("ab", ZONE, keys='zone = "z"\n'))
    one.at_once = 1
    one.does["a"] = failed(JobState.FAULT, "drive.left")
    result = one.run()
    assert one.states() == {"a": "fault", "b": "waiting"}
    assert (result.exit_code, result.state) == (9, FleetState.STOPPED)


def test_another_axis_that_stays_enabled_shows_that_it_was_none(stage: MakeStage) -> None:
    one = stage(text("abc", "[zones.z]\nat_once = 2\n", keys='zone = "z"\n'))
    one.does["a"] = failed(JobState.FAULT, "drive.left")
    one.does["b"] = []

    def pulse() -> None:
        one.crew.say("b", Report("pulse", moving=True))

    for at in (20, 30):
        one.steps[at] = pulse
    one.steps[60] = lambda: one.crew.say("b", *good())
    one.run()
    assert one.states() == {"a": "fault", "b": "done", "c": "done"}
    assert any("stays enabled" in line for line in one.people.told)


def test_an_ordinary_fault_pauses_nothing(stage: MakeStage) -> None:
    one = stage(text("ab", ZONE, keys='zone = "z"\n'))
    one.at_once = 1
    one.does["a"] = failed(JobState.FAULT, "drive.fault")
    one.run()
    assert one.states() == {"a": "fault", "b": "done"}


def lost(name: str) -> list[Report | None]:
    """The link was lost in motion, and nobody knows whether the axis is at rest."""
    outcome = Outcome(error=Error("link.lost", "lost"), ending=f"{name} NOT VERIFIED")
    return [Report("ended", state=JobState.LINK, outcome=outcome, error=outcome.error)]


def test_beside_an_axis_that_may_still_move_nothing_starts_in_its_zone(stage: MakeStage) -> None:
    one = stage(text("ab", ZONE, keys='zone = "z"\n'))
    one.at_once = 1
    one.does["a"] = lost("a")
    one.in_advance = None
    one.people.answers = {"a": YES, "z": NO}
    one.run()
    assert one.states() == {"a": "link", "b": "blocked"}
    assert any("NOT VERIFIED" in line for line in one.people.told)


def test_and_not_in_its_group_either_which_else_would_go_on(stage: MakeStage) -> None:
    one = stage(text("ab", '[groups.g]\non_failure = "go-on"\n', keys='group = "g"\n'))
    one.does["a"] = lost("a")
    one.run()
    assert one.states() == {"a": "link", "b": "blocked"}


def test_a_group_stays_blocked_as_long_as_one_of_it_has_failed(stage: MakeStage) -> None:
    one = stage(text("ab", "[groups.g]\n", keys='group = "g"\n'))
    one.does["a"] = failed(JobState.REJECTED)
    one.run()
    assert one.states() == {"a": "rejected", "b": "blocked"}
    one.run(resume(one.fleet, one.ledger, one.run_id, "ab"))
    assert one.states() == {"a": "rejected", "b": "blocked"}
    one.does["a"] = good()
    one.run(again(one.fleet, one.ledger, one.run_id, ["a"], "ab"))
    assert one.states() == {"a": "done", "b": "blocked"}
    one.run(resume(one.fleet, one.ledger, one.run_id, "ab"))
    assert one.states() == {"a": "done", "b": "done"}


def test_when_the_terminal_is_gone_nothing_more_starts(stage: MakeStage) -> None:
    one = stage(text("ab"))
    one.in_advance = None
    one.people.answers = {"a": Answer.NOBODY}
    one.run()
    assert one.states() == {"a": "waiting", "b": "waiting"}


def test_what_waits_says_for_what(stage: MakeStage) -> None:
    one = stage(text("ab", "[groups.g]\n", keys='group = "g"\n'))
    one.does["a"] = []

    def look() -> None:
        waiting = next(axis for axis in one.people.last.axes if axis.name == "b")
        assert waiting.doing == "'a' of its group is under way"
        one.crew.say("a", *good())

    one.steps[60] = look
    one.run()


# -- interruptions --------------------------------------------------------------------------------


def test_the_first_ctrl_c_starts_nothing_more(stage: MakeStage) -> None:
    one = stage(text("ab"))
    one.at_once = 1
    one.does["a"] = []
    one.steps[10] = lambda: one.interruption._on_signal(signal.SIGINT, None)
    one.steps[40] = lambda: one.crew.say("a", *good())
    with pytest.raises(Interrupted):
        one.run()
    assert one.crew.interrupted == []
    assert one.states() == {"a": "done", "b": "waiting"}
    assert one.people.last.state is FleetState.STOPPED


@pytest.mark.parametrize("signals", [[signal.SIGINT, signal.SIGINT], [signal.SIGTERM]])
def test_the_second_stops_what_runs(stage: MakeStage, signals: list[int]) -> None:
    one = stage(text("ab"))
    one.at_once = 1
    one.does["a"] = []
    for n, number in enumerate(signals):
        one.steps[10 + 10 * n] = lambda number=number: one.interruption._on_signal(number, None)
    one.steps[60] = lambda: one.crew.say("a", *failed(JobState.STOPPED))
    with pytest.raises(Interrupted):
        one.run()
    assert one.crew.interrupted == ["a"]
    assert one.states() == {"a": "stopped", "b": "waiting"}


@pytest.mark.parametrize(("request_", "interrupted"), [("drain", []), ("stop", ["a"])])
def test_somebody_else_can_end_it(stage: MakeStage, request_: str, interrupted: list[str]) -> None:
    one = stage(text("ab"))
    one.at_once = 1
    one.does["a"] = []
    one.steps[10] = lambda: one.ledger.ask(one.run_id, request_)
    one.steps[60] = lambda: one.crew.say("a", *good())
    result = one.run()
    assert one.crew.interrupted == interrupted
    assert result.state is FleetState.STOPPED
    assert one.states()["b"] == "waiting"


def test_two_signals_at_once_are_two(stage: MakeStage) -> None:
    one = stage(text("ab"))
    one.at_once = 1
    one.does["a"] = []

    def twice() -> None:
        for _ in range(2):
            one.interruption._on_signal(signal.SIGINT, None)

    one.steps[10] = twice
    one.steps[60] = lambda: one.crew.say("a", *failed(JobState.STOPPED))
    with pytest.raises(Interrupted):
        one.run()
    assert one.crew.interrupted == ["a"]


def test_a_stop_after_a_drain_is_heard(stage: MakeStage) -> None:
    one = stage(text("ab"))
    one.at_once = 1
    one.does["a"] = []
    one.steps[10] = lambda: one.ledger.ask(one.run_id, "drain")
    one.steps[40] = lambda: one.ledger.ask(one.run_id, "stop")
    one.steps[80] = lambda: one.crew.say("a", *failed(JobState.STOPPED))
    one.run()
    assert one.crew.interrupted == ["a"]
    assert "fleet stop" in one.ledger.rows(one.run_id)["a"].why


def test_a_ledger_that_fails_starts_nothing_more_and_hears_ctrl_c(stage: MakeStage) -> None:
    one = stage(text("ab"))
    one.at_once = 1
    one.does["a"] = []

    def fail() -> None:
        def full(*_arguments: object, **_keywords: object) -> None:
            raise JournalError("the disk is full")

        for name in ("request", "move", "end", "set_state", "explain"):
            setattr(one.ledger, name, full)

    one.steps[10] = fail
    for at in (30, 40):
        one.steps[at] = lambda: one.interruption._on_signal(signal.SIGINT, None)
    one.steps[60] = lambda: one.crew.say("a", *failed(JobState.STOPPED))
    with pytest.raises(Interrupted):
        one.run()
    assert one.crew.interrupted == ["a"]
    assert isinstance(one.conductor.error, JournalError)
    assert [order.name for order in one.crew.orders] == ["a"]


# -- workers that die -----------------------------------------------------------------------------


def test_a_worker_that_dies_before_it_starts_leaves_it_revoked(stage: MakeStage) -> None:
    one = stage(text("ab"))
    one.does["a"] = [None]
    one.run()
    assert one.states() == {"a": "revoked", "b": "done"}


def test_a_worker_that_dies_at_work_leaves_it_unknown(stage: MakeStage) -> None:
    one = stage(text("ab", "[groups.g]\n", keys='group = "g"\n'))
    one.does["a"] = [Report("step", step=1, steps=3), None]
    one.run()
    assert one.states() == {"a": "unknown", "b": "blocked"}


def test_a_worker_that_has_told_the_ledger_alone_is_believed(stage: MakeStage) -> None:
    one = stage(text("a"))
    one.does["a"] = [Report("step", step=1, steps=3)]

    def die() -> None:
        outcome = Outcome(run="r", at_rest=True)
        one.ledger.end(one.run_id, "a", 1, JobState.DONE, outcome, "")
        one.crew.say("a", None)

    one.steps[30] = die
    result = one.run()
    assert result.exit_code == 0
    assert result.axes[0].outcome is not None
    assert result.axes[0].outcome.run == "r"


def test_what_was_not_granted_is_revoked(stage: MakeStage) -> None:
    one = stage(text("a"))
    one.does["a"] = [Report("void", text="not granted")]
    one.run()
    assert one.states() == {"a": "revoked"}


def test_late_cycles_hold_up_the_next(stage: MakeStage) -> None:
    real = HEAD.format("group") + "".join(
        f'[[axes]]\nname = "{name}"\nlink = "modbus-tcp://127.0.0.1:{port}"\ntravel = 1.0\n'
        for name, port in (("a", 5001), ("b", 5002), ("c", 5003))
    )
    one = stage(real)
    one.at_once = 2
    one.does["a"], one.does["b"] = [], []
    one.steps[10] = lambda: one.crew.say("a", Report("pulse", moving=True, late=0.2))
    one.steps[20] = lambda: one.crew.say("b", *good())

    def look() -> None:
        assert one.states() == {"a": "started", "b": "done", "c": "waiting"}
        one.crew.say("a", Report("pulse", moving=True, late=0.0))

    one.steps[60] = look
    one.steps[90] = lambda: one.crew.say("a", *good())
    one.run()
    assert set(one.states().values()) == {"done"}


def test_the_order_holds_what_was_confirmed(stage: MakeStage) -> None:
    one = stage(text("a"))
    one.run()
    (order,) = one.crew.orders
    assert order.room == one.ledger.rows(one.run_id)["a"].confirmed.room
    assert order.options.serial == one.ledger.rows(one.run_id)["a"].serial


# -- what an earlier part of the run has left ------------------------------------------------------


def test_only_what_is_asked_for_goes_on(stage: MakeStage) -> None:
    """An earlier part has left axes waiting: nobody asks for them, and nobody moves them."""
    one = stage(text("abc"))
    one.at_once = 1
    one.does["a"] = []
    one.steps[10] = lambda: one.ledger.ask(one.run_id, "drain")
    one.steps[30] = lambda: one.crew.say("a", *good())
    one.run()
    assert one.states() == {"a": "done", "b": "waiting", "c": "waiting"}
    one.steps = {}
    one.in_advance = None
    one.people.answers = {"a": YES, "c": YES}
    one.does["a"] = good()
    one.run(again(one.fleet, one.ledger, one.run_id, ["a"], "abc"))
    assert one.states() == {"a": "done", "b": "waiting", "c": "waiting"}
    one.run(resume(one.fleet, one.ledger, one.run_id, "c"))
    assert one.states() == {"a": "done", "b": "waiting", "c": "done"}
    assert [word for word, _ in one.people.asked] == ["a", "c"]


def test_a_zone_stays_paused_beside_an_axis_that_is_not_verified(stage: MakeStage) -> None:
    one = stage(text("ab", ZONE, keys='zone = "z"\n'))
    one.at_once = 1
    one.does["a"] = lost("a")
    one.run()
    assert one.states() == {"a": "link", "b": "waiting"}
    one.run(resume(one.fleet, one.ledger, one.run_id, "ab"))
    assert one.states() == {"a": "link", "b": "waiting"}
    one.does["a"] = good()
    one.run(again(one.fleet, one.ledger, one.run_id, ["a"], "ab"))
    one.run(resume(one.fleet, one.ledger, one.run_id, "ab"))
    assert one.states() == {"a": "done", "b": "done"}


def test_a_drive_that_is_disabled_wakes_no_zone_that_is_paused_for_more(stage: MakeStage) -> None:
    one = stage(text("abcd", "[zones.z]\n", keys='zone = "z"\n'))
    one.at_once = 3
    one.does["a"] = lost("a")
    one.does["b"] = []
    one.does["c"] = []
    one.steps[20] = lambda: one.crew.say("b", *failed(JobState.FAULT, "drive.left"))
    for at in (30, 40):
        one.steps[at] = lambda: one.crew.say("c", Report("pulse", moving=True))
    one.steps[60] = lambda: one.crew.say("c", *good())
    one.run()
    assert one.states() == {"a": "link", "b": "fault", "c": "done", "d": "waiting"}


def test_a_run_that_was_cut_off_blocks_the_group_of_its_axis(stage: MakeStage) -> None:
    one = stage(text("ab", "[groups.g]\n", keys='group = "g"\n'))
    one.seen["a"] = Error("run.cut-off", "run r on this drive was cut off")
    with Journal(home()) as journal:
        run = journal.begin(
            axis="a", link="virtual://bench?seed=1", profile="p", profile_hash="", serial="0x61",
            context=RunContext("{}"),
        )  # fmt: skip
        journal.intend(run, "experiment", "max_torque", 1, 2)
    one.run()
    assert one.states() == {"a": "blocked", "b": "blocked"}
    one = stage(text("ab", "[groups.g]\n", keys='group = "g"\n'))
    one.run(["b"])
    assert one.states()["b"] == "blocked", "a was not even looked at"


def test_a_row_that_somebody_else_has_moved_is_let_be(stage: MakeStage) -> None:
    one = stage(text("ab"))
    one.at_once = 1
    one.does["a"] = []

    def elsewhere() -> None:
        one.ledger.move(one.run_id, "b", 1, JobState.STOPPED, why="by another")
        one.crew.say("a", *good())

    one.steps[30] = elsewhere
    one.run()
    assert one.states() == {"a": "done", "b": "stopped"}
    assert [order.name for order in one.crew.orders] == ["a"]


def test_one_that_is_not_let_move_blocks_its_group(stage: MakeStage) -> None:
    one = stage(text("ab", "[groups.g]\n", "each", 'group = "g"\n'))
    one.in_advance = None
    one.people.answers = {"a": NO, "b": YES}
    one.run()
    assert one.states() == {"a": "refused", "b": "blocked"}


def test_a_zone_is_asked_for_where_all_else_was_confirmed_in_advance(stage: MakeStage) -> None:
    one = stage(text("ab", ZONE, keys='zone = "z"\n'))
    one.at_once = 1
    one.can_ask = True
    one.does["a"] = failed(JobState.FAULT, "drive.left")
    one.people.answers = {"z": YES}
    one.run()
    assert one.states() == {"a": "fault", "b": "done"}
