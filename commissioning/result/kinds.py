"""What numbers and texts of a result are: finite, and of a length."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

__all__ = ["LONGEST_TEXT", "Count", "Finite", "Pair", "Positive", "Raw", "Share", "Text"]

Finite = Annotated[float, Field(ge=-1e300, le=1e300)]
Positive = Annotated[float, Field(gt=0, le=1e300)]
Share = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=0, lt=1 << 31)]
Raw = Annotated[int, Field(gt=-(1 << 63), lt=1 << 63)]
LONGEST_TEXT = 10_000  # characters
Text = Annotated[str, Field(max_length=LONGEST_TEXT)]
Pair = tuple[Finite, Finite]
