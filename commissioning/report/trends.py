"""A picture of an axis over the years.

Marks differ by shape and lines by dash: they survive a black print.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from textwrap import fill
from typing import Any, cast

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from commissioning.report.figures import BLUE, GREY, ORANGE, STYLE
from commissioning.report.quiet import quiet
from commissioning.result.history import CHARTED, Drift, IndexedRun, Story
from commissioning.result.words import QUANTITY_LABELS

__all__ = ["picture"]

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def picture(story: Story, words: str, happened: Sequence[tuple[float, str]], kind: str) -> bytes:
    """The quantities over time with their intervals, and what happened, as 'svg', 'png' or 'pdf'.

    `words` : beneath its name. `happened` : s since 1970, and what
    """
    shown = [name for name in CHARTED if any(name in one.quantities for one in story.entries)]
    stream = io.BytesIO()
    with mpl.rc_context(STYLE), quiet():
        rows = max(len(shown), 1)
        figure = Figure(figsize=(9.2, 1.0 + 2.2 * rows), layout="constrained")
        panels = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
        figure.suptitle(story.axis, x=0.01, ha="left", fontsize=11, weight="bold")
        panels[0].set_title(fill(words, 125), loc="left", fontsize=8.5)
        if not shown:
            panels[0].text(0.5, 0.5, "nothing was measured yet", ha="center", va="center")
        for axes, name in zip(panels, shown, strict=False):
            drift = next((one for one in story.drifts if one.quantity == name), None)
            _panel(axes, [one for one in story.entries if name in one.quantities], name, drift)
            for number, (at, text) in enumerate(happened):
                axes.axvline(_date(at), color=GREY, lw=0.9, ls="--")
                if axes is panels[0]:
                    _label(axes, _date(at), text, number)
        untyped: Callable[..., Any] = AutoDateLocator
        locator, formatter = untyped(), cast("Callable[..., Any]", ConciseDateFormatter)
        panels[-1].xaxis.set_major_locator(locator)
        panels[-1].xaxis.set_major_formatter(formatter(locator))
        figure.savefig(stream, format=kind, dpi=150)
    return stream.getvalue()


def _panel(axes: Axes, entries: Sequence[IndexedRun], name: str, drift: Drift | None) -> None:
    unit = entries[0].quantities[name].unit
    alike = {one.run for one in drift.points} if drift else set()
    for inside, color, mark, label in (
        (True, BLUE, "o", "compared"),
        (False, GREY, "x", "under other conditions, or before"),
    ):
        those = [one for one in entries if (one.run in alike) == inside]
        if those:
            _points(axes, those, name, color=color, fmt=mark, label=label)
    if drift is not None and drift.centre is not None and drift.sigma is not None:
        since = drift.points[0].began
        span = [_date(since), _date(drift.points[-1].began)]
        axes.plot(span, [drift.centre] * 2, color=BLUE, lw=1.0, ls=":", label="centre")
        for one in drift.points:
            if one.run == drift.first_run:
                axes.plot(
                    [_date(one.began)], [one.value], "s", ms=11, mfc="none", mec=ORANGE, mew=1.6,
                    label="first seen",
                )  # fmt: skip
    axes.set_ylabel(f"{QUANTITY_LABELS[name]}\nin {unit}")
    axes.legend(loc="upper left", fontsize=7, ncols=4)
    axes.margins(y=0.25)


def _points(axes: Axes, entries: Sequence[IndexedRun], name: str, **how: Any) -> None:
    found = [one.quantities[name] for one in entries]
    below = [q.value - q.low if q.low is not None else 0.0 for q in found]
    above = [q.high - q.value if q.high is not None else 0.0 for q in found]
    axes.errorbar(
        [_date(one.began) for one in entries], [q.value for q in found], ms=4, lw=0.8, capsize=2,
        yerr=[[max(e, 0.0) for e in below], [max(e, 0.0) for e in above]], **how,
    )  # fmt: skip


def _label(axes: Axes, at: datetime, text: str, number: int) -> None:
    axes.annotate(
        text if len(text) <= 40 else f"{text[:39]}…", (at, 0), (2, 3 + 9 * (number % 3)),
        xycoords=("data", "axes fraction"), textcoords="offset points", fontsize=7, color="#333333",
    )  # fmt: skip


def _date(instant: float) -> Any:
    return _EPOCH + timedelta(seconds=instant)
