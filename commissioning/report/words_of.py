"""What stands on paper and on the screen alike."""

from __future__ import annotations

from commissioning.result.document import RunResult
from commissioning.result.language import said
from commissioning.samples import Samples

__all__ = ["foot_of", "proofs_of"]

_PROOFS = ("stop path proved", "proof of the watchdog", "the drive noticed it")


def foot_of(result: RunResult, created: str) -> str:
    """What stands at the foot of each page: run, version, operator, time with its zone."""
    tool = f"tworelay {result.tool.version}" if result.tool else "tworelay"
    parts = [result.run or result.axis, tool, result.operator or "", created]
    return " · ".join([*filter(None, parts), said("tworelay is not a safety function.")])


def proofs_of(samples: Samples | None) -> list[str]:
    """What was said of the proofs while the run went on."""
    if samples is None:
        return []
    return [phase.text for phase in samples.phases if phase.text.startswith(_PROOFS)]
