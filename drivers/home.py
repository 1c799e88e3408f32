"""Where tworelay keeps its state."""

from __future__ import annotations

import os
from pathlib import Path

__all__ = ["home"]


def home() -> Path:
    """TWORELAY_HOME, or the platform's folder for application data. Not created here."""
    named = os.environ.get("TWORELAY_HOME")
    if named:
        return Path(named)
    from platformdirs import user_data_path

    return user_data_path("tworelay", appauthor=False)
