"""A counter that wraps, against arithmetic without end."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from drivers.counter import Counter

WIDTHS = st.sampled_from([(-(1 << 31), (1 << 31) - 1), (0, 131071), (0, 65535), (-500, 499)])


@given(WIDTHS, st.integers(-(10**9), 10**9), st.lists(st.floats(-0.49, 0.49), max_size=60))
def test_what_is_followed_is_the_way_that_was_gone(
    ends: tuple[int, int], begin: int, turns: list[float]
) -> None:
    low, high = ends
    width = high - low + 1
    counter, place = Counter(low, high), begin

    def shown() -> int:
        return (place - low) % width + low

    first = counter.follow(shown())
    assert first == shown(), "the first is as it comes"
    for turn in turns:
        place += int(turn * width)
        assert counter.follow(shown()) - first == place - begin
        assert shown() + counter.offset == first + place - begin
