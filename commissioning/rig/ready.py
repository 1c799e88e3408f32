"""An axis that is ready for its oscillations.

First motions done, stop path proved, design chosen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from commissioning.desk import Options
from commissioning.envelope import Envelope
from commissioning.errors import EnvelopeTripped, FeedbackReversed, MeasurementRejected
from commissioning.experiments.design import PeriodNeeds, RelayDesign, design
from commissioning.experiments.first_look import FirstLook
from commissioning.experiments.plan import Context, Plan
from commissioning.experiments.stopping import Stopping
from commissioning.identification.modulating import ModulatingEstimate
from commissioning.identification.output_error import OutputErrorEstimate
from commissioning.identification.record import Record, trusted, unfiltered
from commissioning.identification.verdict import UnitNames
from commissioning.rig.mover import Mover
from commissioning.watching import Watcher
from drivers.errors import PreflightRefused
from drivers.sample import Sample

__all__ = ["Ready", "record_of"]

T = TypeVar("T")

_SOUND_SHARE = 0.35, 0.72  # f/d1 of well-conditioned oscillations
_WIDEST_KNOWN = 0.3  # relative half-width of f up to which it is worth a new design
_LEAST_CHANGE = 0.87  # of d1: a smaller change is none


@dataclass(frozen=True, slots=True)
class Ready:
    """What the methods work on.

    Attributes
    ----------
    known : what the first motions, or a first record, have shown
    stopping : what braking is certain
    pace : of the oscillations
    design : the oscillations, for this axis
    """

    mover: Mover
    options: Options
    context: Context
    units: UnitNames
    envelope: Envelope
    known: FirstLook
    stopping: Stopping
    pace: PeriodNeeds
    design: RelayDesign

    @classmethod
    def of(
        cls,
        mover: Mover,
        options: Options,
        context: Context,
        units: UnitNames,
        envelope: Envelope,
        known: FirstLook,
        stopping: Stopping,
        pace: PeriodNeeds,
    ) -> Ready:
        """Choose the oscillations, and what the envelope must allow for them.

        Raises MeasurementRejected, PreflightRefused where none fits.
        """
        chosen = design(context, known, stopping, pace)
        envelope = replace(envelope, cautious=False, stopping=stopping, relay_torque=chosen.most)
        return cls(mover, options, context, units, envelope, known, stopping, pace, chosen)

    def redesigned(self, found: ModulatingEstimate | OutputErrorEstimate) -> Ready | None:
        """The axis with other oscillations, by a first record; None: they were right."""
        f, before = found.coulomb.value, self.design
        if not 0 < f < self.context.torque or found.coulomb.half_width > _WIDEST_KNOWN:
            return None
        if not found.inertia.value > 0 or _SOUND_SHARE[0] <= f / before.d1 <= _SOUND_SHARE[1]:
            return None
        known = replace(
            self.known,
            coulomb=f,
            breakaway=max(f, found.low_speed),
            inertia=found.inertia.value,
            viscous=max(found.viscous.value, 0.0),
        )
        try:
            again = Ready.of(
                self.mover, self.options, self.context, self.units, self.envelope, known,
                self.stopping, self.pace,
            )  # fmt: skip
        except (MeasurementRejected, PreflightRefused):
            return None
        d1, d2 = again.design.d1, again.design.d2
        if d1 >= _LEAST_CHANGE * before.d1 and d1 * _LEAST_CHANGE <= before.d1:
            return None
        e = self.units.effort
        self.context.tell(
            f"the friction is about {f:.3g} {e}: again with ±{d1:.4g} and ±{d2:.4g} {e}"
        )
        return again

    def run(self, plan: Plan[T]) -> T:
        """Drive a plan to its end, from and to the torque that balances the axis."""
        return self.mover.move(plan, self.envelope, self.known.offset)

    def attempt(self, plan: Plan[T]) -> T:
        """Drive a plan that need not be: a limit that ends it rejects it, once the axis is safe."""
        try:
            return self.run(plan)
        except EnvelopeTripped as error:
            if isinstance(error, FeedbackReversed) or self.mover.is_energised:
                raise
            raise MeasurementRejected(str(error), code="measurement.limit") from None

    @property
    def watcher(self) -> Watcher:
        """Whoever looks on."""
        return self.mover.recorder.watcher

    @property
    def time_left(self) -> float:
        """Time that is left of the allowed duration, s."""
        return self.envelope.duration - self.mover.spent

    def heat(self, torque: float, seconds: float) -> float:
        """Share of the i²t budget in use after a torque about the bias for `seconds`.

        `torque` : N.m or N, either way.
        """
        more = torque**2 + self.known.offset**2 - self.envelope.rated**2
        return (self.mover.heat_left() + max(more, 0.0) * seconds) / self.envelope.thermal

    def record(self, begin: float, end: float) -> Record:
        """What was recorded between two instants (s), a filter in the position signal undone."""
        return self._record(begin, end).between(begin, end)

    def records(self, spans: Sequence[tuple[float, float]]) -> Record:
        """The same of several stretches, (begin, end) in s, as one record with gaps."""
        whole = self._record(spans[0][0], spans[-1][1])
        used = np.zeros(len(whole.time), bool)
        for begin, end in spans:
            used |= (whole.time >= begin) & (whole.time <= end)
        return replace(whole, time=whole.time[used], position=whole.position[used])

    def _record(self, begin: float, end: float) -> Record:
        # commands before the record act in it, too
        early = begin - self.design.period
        cut = [s for s in self.mover.recorder.samples if early <= s.time <= end]
        sound = trusted(np.array([s.lateness for s in cut]), self.context.cycle)
        kept = [s for s, is_sound in zip(cut, sound.tolist(), strict=True) if is_sound]
        whole = record_of(kept, cut, self.context.resolution)
        if self.options.output_filter:
            whole = unfiltered(whole, self.options.output_filter)
        return whole


def record_of(seen: list[Sample], commanded: list[Sample], resolution: float) -> Record:
    """Positions of the samples that are trusted, and every command."""
    return Record.of(
        [s.time for s in seen],
        [s.position for s in seen],
        [s.sent for s in commanded],
        [s.command for s in commanded],
        resolution,
    )
