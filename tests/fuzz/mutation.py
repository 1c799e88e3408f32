"""Files and answers that nobody meant: a good one, mutated."""

from __future__ import annotations

import os
from typing import Any

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

__all__ = ["fuzzed", "mutated", "slowly_fuzzed"]

# `make fuzz` asks for many thousands
CASES = int(os.environ.get("TWORELAY_FUZZ", "60"))
fuzzed = settings(
    max_examples=CASES, deadline=None, database=None, derandomize=CASES <= 1000,
    suppress_health_check=list(HealthCheck),
)  # fmt: skip

slowly_fuzzed = settings(
    fuzzed, max_examples=max(CASES // 10, min(CASES, 60))
)  # 0.1 s and more each

_NASTY = (
    b"\0", b"\xff", b"\xef\xbb\xbf", b"=", b"[", b"]", b'"', b"'", b"\n", b"\r", b"-", b"9" * 40,
    b"1e999",
    b"nan", b"0x", b"$NODEID", b"-0x8000", b"true", b"{}", b"[[", b"\xf0\x9f\x92\xa9", b"9" * 5000,
    b";",
    b",",
)  # fmt: skip
_EDIT = st.tuples(
    st.sampled_from(("insert", "delete", "replace", "double", "move")),
    st.floats(0, 1),
    st.integers(1, 60),
    st.one_of(st.sampled_from(_NASTY), st.binary(max_size=8)),
)


@st.composite
def mutated(draw: Any, *originals: bytes) -> bytes:
    """One of `originals` after some edits."""
    data = draw(st.sampled_from(originals))
    for kind, where, length, payload in draw(st.lists(_EDIT, min_size=1, max_size=6)):
        at = int(where * len(data))
        piece = data[at : at + length]
        if kind == "insert":
            data = data[:at] + payload + data[at:]
        elif kind == "delete":
            data = data[:at] + data[at + length :]
        elif kind == "replace":
            data = data[:at] + payload + data[at + length :]
        elif kind == "double":
            data = data[:at] + piece + data[at:]
        else:
            data = piece + data[:at] + data[at + length :]
    return bytes(data)
