"""One transaction of a job breaks, in every way.

The axis is at rest, and everything is put back or named.
"""

from __future__ import annotations

import contextlib
import os
import random
from collections.abc import Iterator

import pytest

from tests.faults.proxy import WIRES, Way
from tests.faults.rig import Rig, ways
from tests.faults.served import served

_TRIES = 4
_A_WAY = 2  # cases on a wire; `make faults` tries every one


@pytest.fixture(scope="module", params=list(WIRES))
def rig(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    if os.name == "nt" and WIRES[request.param].pty:
        pytest.skip("no pseudo-terminals")
    with (
        served(request.param) as links,
        contextlib.closing(Rig(links, request.param, tmp_path_factory.mktemp("home"))) as made,
    ):
        yield made


def test_one_broken_transaction(rig: Rig) -> None:
    for _ in range(_TRIES):  # a busy computer may lose a link by itself
        answered, code = rig.case(None, Way.LOST_ANSWER)
        if not code:
            break
    assert code == 0
    assert len(answered) > 100
    draw, cases = random.Random(0), ways(answered)
    for way in Way:
        for at, _ in draw.sample([case for case in cases if case[1] is way], _A_WAY):
            rig.case(at, way)
