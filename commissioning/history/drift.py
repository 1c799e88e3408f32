"""Whether an axis gets worse: an EWMA chart of what was measured under like conditions.

Roberts, Control chart tests based on geometric moving averages, Technometrics 1 (1959); Lucas and
Saccucci, Exponentially weighted moving average control schemes, Technometrics 32 (1990).
Temperature and load change friction more than wear does (Bittencourt and Axelsson, IEEE/ASME
T-Mechatronics 19 (2014)), so only runs alike are compared.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf, sqrt
from statistics import fmean

from commissioning.result.history import Drift, IndexedRun, Note, ValueSeen

__all__ = ["BASELINE", "GATE", "LIMIT", "Chart", "drift", "is_behind", "segment"]

BASELINE = 20  # like runs before there is a chart
TRIAL = 20  # runs, until one that was in control is of the baseline
FIRST = "the first run"
GATE = 10.0  # %: a smaller change is no alarm
WEIGHT = 0.2  # of the newest run
LIMIT = 2.86 * sqrt(WEIGHT / (2 - WEIGHT))
_TEMPERATURE = 10.0  # K
_KINDS = 20  # of conditions that are looked at
_SPREAD = 3.0  # K, of a baseline that tells what the temperature does
_USUAL, _STEEPEST = 0.01, 0.03  # a kelvin, by which friction falls: of most greases, and of any
_PRESENT = 5  # runs that tell the level now
_SURE = 1.96  # of a normal distribution, 95 %


class Chart:
    """An EWMA of standardised deviations.

    Parameters
    ----------
    centre, between : mean, and standard deviation from run to run beside each run's own, where they
        are known; else they are those of `baseline` runs, and of all runs in control since
    gate : change below which there is no alarm, %
    """

    def __init__(
        self,
        *,
        centre: float | None = None,
        between: float = 0.0,
        baseline: int = BASELINE,
        gate: float = GATE,
    ) -> None:
        self.centre, self.between = centre, between
        self.ewma = 0.0
        self.change = 0.0  # EWMA of the deviation, as a share of the centre
        self._known, self._needed, self._gate = centre is not None, baseline, gate / 100
        self.baseline = 0  # runs that made the centre
        self._squares = 0.0  # of their deviations, summed
        self._own = 0.0  # of their own variances, likewise
        self._warmth = _Warmth()
        self._on_trial: deque[tuple[float, float, float | None]] = deque()

    def sigma(self, own: float) -> float:
        """Standard deviation of a run whose own is `own`."""
        least = 1e-9 * abs(self.centre or 0.0)
        return max(sqrt(own**2 + self.between**2), least)

    @property
    def explained(self) -> float:
        """What the temperature explains of `change`, as a share of the centre."""
        return self._warmth.share(self.change, self.centre or inf)

    def add(self, value: float, own: float, temperature: float | None = None) -> bool | None:
        """Take in a run with its own standard deviation; returns whether it alarms.

        None while the baseline is made. `temperature`: of the motor, °C; it explains what it can.
        """
        if not self._known and self.baseline < self._needed:
            self._learn(value, own, temperature)
            return None
        self._warmth.follow(temperature)
        assert self.centre is not None
        sigma, away = self.sigma(own), value - self.centre
        z = away / sigma if sigma else (0.0 if not away else inf)
        self.ewma += WEIGHT * (z - self.ewma)
        share = away / abs(self.centre) if self.centre else inf
        self.change += WEIGHT * (share - self.change)
        out = abs(self.ewma) > LIMIT
        if not self._known:
            self._grow(value, own, temperature, in_control=not out)
        left = self.change - self.explained
        return out and min(abs(self.change), abs(left)) >= self._gate

    def _grow(
        self, value: float, own: float, temperature: float | None, *, in_control: bool
    ) -> None:
        """A run is known to be in control when the chart has stayed so for TRIAL more.

        A change that is not seen yet would be learnt otherwise, and never seen.
        """
        if not in_control:
            self._on_trial.clear()
            return
        self._on_trial.append((value, own, temperature))
        if len(self._on_trial) > TRIAL:
            self._learn(*self._on_trial.popleft())

    def _learn(self, value: float, own: float, temperature: float | None) -> None:
        """By Welford's recursion."""
        self.baseline += 1
        before = value if self.centre is None else self.centre
        self.centre = before + (value - before) / self.baseline
        self._squares += (value - before) * (value - self.centre)
        self._own += own**2
        if self.baseline > 1:
            all_of_it = self._squares / (self.baseline - 1)
            self.between = sqrt(max(all_of_it - self._own / self.baseline, 0.0))
        self._warmth.learn(temperature, value)


class _Warmth:
    """What the motor's temperature does to a quantity, by the runs of the baseline.

    Where those are all as warm, it falls by nothing to _USUAL a kelvin.
    """

    def __init__(self) -> None:
        self._count = 0
        self._mean = self._value = self._squares = self._products = 0.0
        self.now: float | None = None

    def learn(self, temperature: float | None, value: float) -> None:
        """A run of the baseline, °C."""
        if temperature is None:
            return
        self._count += 1
        before = temperature - self._mean
        self._mean += before / self._count
        self._value += (value - self._value) / self._count
        self._squares += before * (temperature - self._mean)
        self._products += before * (value - self._value)

    def follow(self, temperature: float | None) -> None:
        """How warm it is now, in the mean of the chart."""
        if temperature is not None and self._count:
            before = self._mean if self.now is None else self.now
            self.now = before + WEIGHT * (temperature - before)

    def share(self, change: float, centre: float) -> float:
        """What it explains of a change, both as shares of the centre."""
        if self.now is None or self._count < 2:
            return 0.0
        warmer = self.now - self._mean
        if sqrt(self._squares / self._count) >= _SPREAD:
            slope = self._products / self._squares / abs(centre)
            return min(max(slope, -_STEEPEST), _STEEPEST) * warmer
        most = -_USUAL * warmer
        return min(max(change, min(most, 0.0)), max(most, 0.0))


# -- which runs are compared ----------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Segment:
    """Runs since the last event that ends a baseline, and what that was."""

    entries: tuple[IndexedRun, ...]
    text: str
    at: float | None


def segment(entries: Sequence[IndexedRun], notes: Sequence[Note]) -> Segment:
    """The measured runs of an axis since its last event."""
    measured = [one for one in entries if one.measured]
    begin, text = 0, FIRST
    at = measured[0].began if measured else None
    for number, (before, one) in enumerate(pairwise(measured), 1):
        if (event := _event(before, one)) is not None:
            begin, text, at = number, event, one.began
    for note in notes:
        behind = [n for n, one in enumerate(measured) if is_behind(one, note)]
        first = behind[0] if behind else len(measured)
        if first >= begin:
            begin, text, at = first, f"the note '{note.text}'", note.at
    return Segment(tuple(measured[begin:]), text, at)


def is_behind(entry: IndexedRun, note: Note) -> bool:
    """Whether a run came after a note: in the journal's order where that tells, else by date."""
    if not note.dated and not entry.adopted:
        return entry.number > note.number
    return entry.began >= note.at


def _event(before: IndexedRun, after: IndexedRun) -> str | None:
    """What ends a baseline between two runs."""
    if before.serial != after.serial:
        return f"the drive was exchanged for {after.serial or 'one without a serial number'}"
    if before.method != after.method:
        return f"the method became '{after.method}'"
    if _major(before.version) != _major(after.version):
        return f"tworelay became {after.version}"
    return None


def _major(version: str | None) -> tuple[str, ...]:
    """Major version; below 1, where every minor one may differ, that too."""
    parts = (version or "0.1").split(".")
    return tuple(parts[:1]) if parts[0] != "0" else tuple(parts[:2])


def _unlike(one: IndexedRun, newest: IndexedRun) -> str | None:
    """Why two runs are not compared, in words; None where they are alike."""
    here, there = one.conditions, newest.conditions
    a, b = here.motor_temperature, there.motor_temperature
    if (a is None) != (b is None):
        return f"{'without' if a is None else 'with'} a known motor temperature"
    if a is not None and b is not None and abs(a - b) > _TEMPERATURE:
        return "colder" if a < b else "warmer"
    if here.third == there.third:
        return None
    known = None not in (here.third, there.third)
    return "in another third of the travel" if known else "with the place known in one only"


# -- the chart ------------------------------------------------------------------------------------


def drift(
    entries: Sequence[IndexedRun], notes: Sequence[Note], quantity: str, *, gate: float = GATE
) -> Drift | None:
    """Whether a quantity has changed; None where no run has measured it, or it is 0.

    `gate` : change below which there is no alarm, %
    """
    since = segment(entries, notes)
    there = [one for one in entries if one.measured and quantity in one.quantities]
    those = [one for one in since.entries if quantity in one.quantities]
    if not there:
        return None
    unit = (those or there)[-1].quantities[quantity].unit
    those = [one for one in those if one.quantities[quantity].unit == unit]
    if not those:
        return Drift(quantity, unit, "not enough runs", since=since.at, since_text=since.text)
    found = _as_of(those[-1], those, quantity, since, gate)
    if found is None or found.alarm:
        return found
    for one in _of_other_conditions(those):
        other = _as_of(one, those, quantity, since, gate)
        if other is not None and other.alarm:
            return other  # the last run, under other conditions, does not end it
    return found


def _as_of(
    newest: IndexedRun, those: Sequence[IndexedRun], quantity: str, since: Segment, gate: float
) -> Drift | None:
    """What the chart says of the runs that are like one of them."""
    why = [_unlike(one, newest) for one in those]
    alike = [one for one, unlike in zip(those, why, strict=True) if unlike is None]
    seen = tuple(_seen(one, quantity) for one in alike)
    counted = Counter(unlike for unlike in why if unlike is not None)
    newer = len(those) - 1 - max(n for n, unlike in enumerate(why) if unlike is None)
    bare = Drift(
        quantity, newest.quantities[quantity].unit, "not enough runs", seen,
        len(those) - len(alike), newer, tuple(f"{count} {text}" for text, count in counted.items()),
        since=seen[0].began if since.text == FIRST else since.at, since_text=since.text,
        said=_said(newest) if len(seen) > 1 else (),
    )  # fmt: skip
    return _charted(bare, gate) if len(seen) > BASELINE else _outside(bare, gate)


def _of_other_conditions(those: Sequence[IndexedRun]) -> list[IndexedRun]:
    """Of each other kind of conditions the last run, the newest first.

    A kind with too few runs for a chart counts while it is one of the last runs.
    """
    found: list[IndexedRun] = []
    kinds = {_kind(those[-1])}
    for age, one in enumerate(reversed(those)):
        if _kind(one) not in kinds:
            kinds.add(_kind(one))
            like = sum(_unlike(other, one) is None for other in those)
            if age < BASELINE or like > BASELINE:
                found.append(one)
        if len(kinds) > _KINDS:
            break
    return found


def _kind(one: IndexedRun) -> tuple[int | None, int | None]:
    """Conditions, to two kelvins."""
    warm = one.conditions.motor_temperature
    return None if warm is None else round(warm / 2), one.conditions.third


def _seen(entry: IndexedRun, quantity: str) -> ValueSeen:
    found, warm = entry.quantities[quantity], entry.conditions.motor_temperature
    return ValueSeen(entry.run, entry.began, found.value, found.low, found.high, warm)


def _said(newest: IndexedRun) -> tuple[str, ...]:
    seen = newest.conditions
    said = []
    if seen.motor_temperature is None:
        said.append("the motor's temperature is not known, and friction falls with it")
    if seen.third is None:
        said.append(
            "the place in the travel is not known ('ends = [low, high]' under [limits] of an axis "
            "file tells it)"
        )
    return tuple(said)


def _outside(found: Drift, gate: float) -> Drift:
    """Too few runs for a chart: whether the newest and the first exclude each other."""
    first, last = found.points[0], found.points[-1]
    if None in (first.low, first.high, last.low, last.high) or not first.value:
        return found
    assert first.low is not None
    assert first.high is not None
    assert last.low is not None
    assert last.high is not None
    if last.low <= first.high and first.low <= last.high:
        return found
    change = 100 * (last.value - first.value) / abs(first.value)
    error = sqrt((last.high - last.low) ** 2 + (first.high - first.low) ** 2) / 2
    warmth = _Warmth()
    if first.temperature is not None and last.temperature is not None:
        warmth.learn(first.temperature, first.value)
        warmth.learn(first.temperature, first.value)
        warmth.now = last.temperature
    explained = 100 * warmth.share(change / 100, first.value)
    return replace(
        found,
        state="changed",
        alarm=min(abs(change), abs(change - explained)) >= gate,
        explained=explained,
        change=change,
        change_error=100 * error / abs(first.value),
        first_seen=last.began,
        first_run=last.run,
    )


def _own(one: ValueSeen) -> float:
    """Standard deviation of a run by its interval: half of its half-width."""
    return 0.0 if one.low is None or one.high is None else (one.high - one.low) / 4


def _charted(found: Drift, gate: float) -> Drift | None:
    chart = Chart(gate=gate)
    seen: list[ValueSeen] = []
    first: ValueSeen | None = None
    begin = 0  # of the change: the EWMA has had one sign since
    alarm: bool | None = None
    for number, one in enumerate(found.points):
        before = chart.ewma
        alarm = chart.add(one.value, _own(one), one.temperature)
        if alarm is None:
            seen.append(one)
            begin = number + 1
            continue
        if chart.ewma * before <= 0:
            begin = number
        first = (first or one) if alarm else None
        seen.append(replace(one, ewma=chart.ewma))
    if not chart.centre:
        return None
    now = seen[begin:][-_PRESENT:]
    level = fmean(one.value for one in now) - chart.centre
    sigma = chart.sigma(sqrt(fmean(_own(one) ** 2 for one in now)))
    error = _SURE * sigma * sqrt(1 / len(now) + 1 / chart.baseline)
    return replace(
        found,
        state="drifting" if alarm else "in control",
        alarm=bool(alarm),
        points=tuple(seen),
        baseline=chart.baseline,
        centre=chart.centre,
        sigma=sigma,
        limit=LIMIT,
        change=100 * level / abs(chart.centre),
        change_error=100 * error / abs(chart.centre),
        explained=100 * chart.explained,
        first_seen=None if first is None else first.began,
        first_run=None if first is None else first.run,
    )
