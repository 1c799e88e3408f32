"""The panel as text: of any width and height, in colours that only repeat what signs say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.text import Text

from commissioning.result.words import remaining

__all__ = ["picture"]

_NARROWEST, _LOWEST = 40, 12
_NAME = 10  # characters before a bar
_VALUE = 26  # characters after it
_NEAR = 0.9  # of a limit
_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))  # of a braille character


def picture(
    state: Mapping[str, Any],
    trace: Sequence[tuple[float, float]],
    width: int,
    height: int,
    *,
    plain: bool = False,
) -> Text:
    """Draw what the feed has told, in `height` lines of `width` characters at most.

    `plain` : in ASCII
    """
    width, height = max(width, _NARROWEST), max(height, _LOWEST)
    signs = _PLAIN if plain else _SIGNS
    p, e = state["position_unit"], state["effort_unit"]
    start, travel = state["start"], state["travel"]
    lines = [
        _head(state, width),
        _steps(state, width, signs),
        Text(""),
        _bar("position", _less(state.get("position"), start), travel, p, width, signs),
        _bar("torque", state.get("torque"), state["torque_limit"], e, width, signs),
        _bar("speed", state.get("speed"), state["speed_limit"], f"{p}/s", width, signs),
        Text(""),
        _friction(state, e),
        _late(state),
    ]
    said = [Text(line[: width - 3], style="dim") for line in state.get("said", ())]
    foot = Text("Ctrl-C stops the axis", style="bold")
    room = height - len(lines) - len(said) - 3
    if room >= 3 and len(trace) > 1:
        lines += [
            Text(""),
            *_trace(trace, start, travel, width, min(room, height // 2), plain=plain),
        ]
    lines += [*said][: max(height - len(lines) - 2, 0)]
    lines += [Text("")] * (height - len(lines) - 1) + [foot]
    text = Text(no_wrap=True, overflow="crop")
    for n, line in enumerate(lines[:height]):
        line.truncate(width)
        text.append_text(line if n == 0 else Text("\n") + line)
    return text


_SIGNS = {"line": "─", "at": "█", "middle": "┼", "done": "●", "now": "◉", "to": "○", "pm": "±"}
_PLAIN = {"line": "-", "at": "#", "middle": "+", "done": "*", "now": "o", "to": ".", "pm": "+-"}


def _less(value: float | None, start: float) -> float | None:
    return None if value is None else value - start


def _head(state: Mapping[str, Any], width: int) -> Text:
    left = f"tworelay {state['doing']}  {state['axis']}"
    room = width - len(left) - 2
    link = str(state["link"])
    link = link if len(link) <= room else f"{link[: max(room - 1, 0)]}…"
    text = Text(left, style="bold")
    return text.append(f"  {link}" if room > 8 else "", style="dim")


def _steps(state: Mapping[str, Any], width: int, signs: Mapping[str, str]) -> Text:
    number, count = state["number"], state["count"]
    marks = signs["done"] * max(number - 1, 0) + (signs["now"] if number else "")
    marks += signs["to"] * max(count - number, 0)
    left = state.get("left")
    when = "" if left is None else f"about {remaining(left)} left"
    if not state.get("in_real_time", True):
        when = f"simulated time{', ' if when else ''}{when}"
    what = f"step {number} of {count}: {state['step']}" if number else "getting ready"
    text = Text(what, style="bold")
    if len(what) + len(marks) + len(when) + 4 <= width:
        text.append(f"  {marks}")
    gap = width - text.cell_len - len(when)
    return text.append(" " * gap + when) if gap > 0 else text


def _bar(
    name: str, value: float | None, limit: float, unit: str, width: int, signs: Mapping[str, str]
) -> Text:
    """A value between the limits of both directions."""
    length = max(width - _NAME - _VALUE - 2, 10)
    cells = [signs["line"]] * length
    cells[length // 2] = signs["middle"]
    text = Text(f"{name:<{_NAME}}")
    style = ""
    if value is not None:
        share = min(max(value / limit, -1.0), 1.0)
        at = round((share + 1) / 2 * (length - 1))
        cells[at] = signs["at"]
        style = "red" if abs(share) >= _NEAR else "green"
    text.append("[" + "".join(cells) + "]", style=style)
    shown = "–" if value is None else f"{value:+.3g}"
    return text.append(f" {shown} of {signs['pm']}{limit:.3g} {_unit(unit)}")


def _unit(name: str) -> str:
    return name.replace(".", "·")


def _friction(state: Mapping[str, Any], effort: str) -> Text:
    """What is known of it, and how its interval has narrowed."""
    known = state.get("friction") or ()
    if not known:
        return Text(f"{'friction':<{_NAME}}not known yet")
    value, low, high = known[-1]
    text = Text(f"{'friction':<{_NAME}}")
    text.append(f"{value:.4g} {_unit(effort)}", style="bold")
    if low is not None and high is not None:
        text.append(f"   {low:.4g} … {high:.4g}")
    narrowing = [_half(one) for one in known]
    if len(narrowing) > 1:
        text.append("   " + " > ".join(narrowing), style="dim")
    return text


def _half(known: Sequence[float | None]) -> str:
    """Half of the interval, in per cent of the value."""
    value, low, high = known
    if low is None or high is None or not value:
        return "first look"
    return f"±{50 * (high - low) / abs(value):.2g} %"


def _late(state: Mapping[str, Any]) -> Text:
    late, lost, cycles = (state.get(name, 0) for name in ("late", "lost", "cycles"))
    share = f" ({100 * (late + lost) / cycles:.2g} %)" if late + lost else ""
    text = Text(f"{'cycles':<{_NAME}}{cycles}, of them ")
    return text.append(f"{late} late, {lost} lost{share}", style="yellow" if share else "")


def _trace(
    trace: Sequence[tuple[float, float]],
    start: float,
    travel: float,
    width: int,
    rows: int,
    *,
    plain: bool,
) -> list[Text]:
    """The last seconds of the position, between its extremes."""
    begin, end = trace[0][0], trace[-1][0]
    places = [q - start for _, q in trace]
    low, high = min(places), max(places)
    middle, half = (low + high) / 2, max((high - low) / 2, 1e-3 * travel)
    across, down = (1, 1) if plain else (2, 4)
    columns = max(width - _NAME - 12, 10)
    grid = [[0] * columns for _ in range(rows)]
    for (moment, _), place in zip(trace, places, strict=True):
        x = round((moment - begin) / max(end - begin, 1e-9) * (columns * across - 1))
        y = round((middle + half - place) / (2 * half) * (rows * down - 1))
        mark = 1 if plain else _DOTS[y % down][x % across]
        grid[y // down][x // across] |= mark
    lines = []
    for n, row in enumerate(grid):
        edge = middle + half if n == 0 else middle - half if n == rows - 1 else None
        label = "" if edge is None else f"{edge:+.3g}"
        cells = "".join("*" if plain and dot else chr(0x2800 + dot) if dot else " " for dot in row)
        name = f"last {end - begin:.0f} s" if n == 0 else ""
        lines.append(Text(f"{name:<{_NAME}}").append(f"{cells} ", style="cyan").append(label))
    return lines
