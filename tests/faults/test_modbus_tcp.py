"""One transaction of a job breaks, in every way: the axis is at rest, and everything is put back or named."""

from __future__ import annotations

import random
from collections.abc import Iterator

import pytest

from tests.faults.proxy import Way
from tests.faults.rig import Rig
from tests.faults.served import served


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    with served("bench", "--modbus-tcp", "127.0.0.1:0", "--clock", "step") as link:
        yield Rig(link, tmp_path_factory.mktemp("home"))


def test_a_job_through_the_proxy_is_a_job(rig: Rig) -> None:
    count, code = rig.case(None, Way.LOST_ANSWER)
    assert code == 0
    assert count > 100


@pytest.mark.parametrize("way", list(Way))
def test_one_broken_transaction(rig: Rig, way: Way) -> None:
    """A sample of them; `make faults` tries every one."""
    count, _ = rig.case(None, way)
    chosen = random.Random(way)
    for at in sorted(chosen.sample(range(count), 4)):
        rig.case(at, way)
