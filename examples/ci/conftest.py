"""What the tests of the machine share: one drive that is served for all of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest


@pytest.fixture(scope="session")
def press(virtual_drive: Callable[..., Any]) -> Any:
    """The press' drive: friction and load as they were measured at commissioning."""
    return virtual_drive("bench?coulomb=0.14&load=0.05")
