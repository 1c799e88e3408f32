"""Which runs are of which axis."""

from __future__ import annotations

from commissioning.history.axes import chosen, groups, in_order
from commissioning.result.history import Note, Renamed, names_before, noted_name, own_name
from tests.history.made import DAY, MARCH_3, run


def test_an_axis_keeps_its_runs_under_all_its_names() -> None:
    renamed = [Renamed("a", "b", 5), Renamed("b", "c", 9)]
    assert [own_name(*one, renamed) for one in (("a", 4), ("b", 8), ("c", 10))] == ["c"] * 3
    assert set(names_before("c", renamed)) == {"a", "b", "c"}
    assert names_before("z", renamed) == ["z"]


def test_a_name_that_is_given_again_is_another_axis() -> None:
    renamed = [Renamed("a", "b", 5)]
    assert own_name("a", 5, renamed) == "b"
    assert own_name("a", 6, renamed) == "a"


def test_two_axes_change_names_by_a_third() -> None:
    renamed = [Renamed("a", "t", 5), Renamed("b", "a", 5), Renamed("t", "b", 5)]
    assert (own_name("a", 1, renamed), own_name("b", 2, renamed)) == ("b", "a")
    assert set(names_before("a", renamed)) >= {"a", "b"}


def test_what_is_renamed_back_is_what_it_was() -> None:
    renamed = [Renamed("a", "b", 5), Renamed("b", "a", 5)]
    assert own_name("a", 1, renamed) == "a"
    assert own_name("a", 6, renamed) == "a"


def test_a_note_is_renamed_by_what_comes_after_it() -> None:
    """Also where no run lies in between."""
    renamed = [Renamed("a", "t", 5, 1), Renamed("b", "a", 5, 2), Renamed("t", "b", 5, 3)]
    assert noted_name(Note("a", 0.0, "", number=5, renamed=0), renamed) == "b"
    assert noted_name(Note("a", 0.0, "", number=5, renamed=3), renamed) == "a"
    assert noted_name(Note("a", 0.0, "", number=5, of_host="pc-b"), renamed) == "a"


def test_two_computers_with_one_axis_name_have_two_axes() -> None:
    ours = [run(n, 0.1) for n in (1, 2)]
    theirs = [run(3, 0.2, serial="0x9", adopted=True, host="pc-b")]
    found = groups([*ours, *theirs], "here")
    assert [len(one.entries) for one in found] == [2, 1]
    assert chosen(found, None).is_ours
    assert chosen(found, "pc-b").entries == tuple(theirs)
    assert chosen(found, "pc-c") is None


def test_one_drive_is_one_axis_whoever_measured_it() -> None:
    ours, theirs = [run(1, 0.1)], [run(2, 0.1, adopted=True, host="pc-b")]
    (found,) = groups([*ours, *theirs], "here")
    assert found.is_ours
    assert found.hosts == {"pc-b"}


def test_drives_that_tell_no_serial_number_are_not_the_same() -> None:
    theirs = [run(2, 0.1, serial="0x00000000", adopted=True, host="pc-b")]
    assert len(groups([run(1, 0.1, serial="0x00000000"), *theirs], "here")) == 2


def test_runs_taken_in_stand_where_their_date_is_and_ours_where_they_came() -> None:
    a, b = run(1, 0.1, began=MARCH_3 + 9 * DAY), run(2, 0.1, began=MARCH_3)  # a clock set back
    old = run(3, 0.1, began=MARCH_3 + DAY, adopted=True)
    new = run(4, 0.1, began=MARCH_3 + 10 * DAY, adopted=True)
    assert [one.number for one in in_order([a, b, old, new])] == [3, 1, 2, 4]
