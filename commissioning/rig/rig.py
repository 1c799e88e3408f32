"""One connected drive and all that its run has, built whole.

`prepare` makes it ready for a method.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from commissioning.desk import Desk, Options
from commissioning.envelope import Envelope
from commissioning.experiments.creep import balancing_torque
from commissioning.experiments.design import PeriodNeeds
from commissioning.experiments.first_look import STEPS, FirstLook, first_look, torque_steps
from commissioning.experiments.plan import Context, stand
from commissioning.experiments.stopping import Stopping, run_up
from commissioning.experiments.tracking import TrackingPath, TrackingSamples, track
from commissioning.guardian import Guardian
from commissioning.identification.record import Record
from commissioning.identification.verdict import UnitNames
from commissioning.result.experiment import Allowed
from commissioning.rig.expected import AT_REST, FIRST_MOTIONS, STOP_PATH, context_of
from commissioning.rig.mover import Mover
from commissioning.rig.preflight import POSITION, TORQUE, Limits, cautious_speed, still_moving
from commissioning.rig.ready import Ready, record_of
from commissioning.runner import Recorder
from commissioning.settings import Settings
from drivers.drive import Drive
from drivers.errors import DriveFault, PreflightRefused
from profiles.axis import Axis

__all__ = ["Rig"]

_THERMAL = 5.0  # s at twice-and-a-bit the rated torque: budget in rated² seconds
_BRAKING_SHARE = 0.7  # of the braking that was seen, for what is certain
_COASTING_MARGIN = 1.5  # of the time that friction alone takes to stop the axis
_CYCLES_TO_NOTICE = 4  # cycles: three missed ones and the one under way


@dataclass(frozen=True, slots=True)
class Rig:
    """What a run works with.

    Attributes
    ----------
    context : what every experiment on this axis needs to know
    envelope : what may never be exceeded
    loop_lag : time constant of the drive's torque loop, s; 0 where it does not tell it
    """

    axis: Axis
    options: Options
    desk: Desk
    drive: Drive
    limits: Limits
    settings: Settings
    mover: Mover
    context: Context
    envelope: Envelope
    units: UnitNames
    loop_lag: float

    @classmethod
    def of(
        cls,
        axis: Axis,
        options: Options,
        desk: Desk,
        drive: Drive,
        limits: Limits,
        recorder: Recorder,
        settings: Settings,
        guardian: Guardian,
    ) -> Rig:
        """The rig of one run on one connected drive."""
        loops = drive.loops
        context = replace(
            context_of(axis, drive, limits), tell=recorder.phase, detail=recorder.detail
        )
        envelope = Envelope(
            centre=limits.start,
            travel=limits.travel,
            speed=limits.speed,
            cautious=True,
            torque=limits.torque,
            duration=limits.duration,
            rated=limits.rated,
            thermal=_THERMAL * limits.rated**2,
            cycle=drive.cycle,
            resolution=context.resolution,
            position_unit=axis.position_unit,
            effort_unit=axis.effort_unit,
        )
        mover = Mover(
            drive, desk, settings, guardian, limits, recorder,
            without_watchdog=options.without_watchdog,
        )  # fmt: skip
        units = UnitNames(axis.position_unit, axis.effort_unit)
        lag = drive.read(loops.lag).si if loops and loops.lag else 0.0
        return cls(
            axis, options, desk, drive, limits, settings, mover, context, envelope, units, lag
        )

    @property
    def allowed(self) -> Allowed:
        """What the run was allowed, for its result."""
        return Allowed(self.limits.travel, self.limits.torque, self.limits.speed)

    @property
    def recorder(self) -> Recorder:
        """Every sample of the torque experiments, and their phases."""
        return self.mover.recorder

    def as_the_drive_counts(self, name: str, value: float) -> tuple[float | None, str | None]:
        """A torque, N.m or N, in steps of the drive, and what a step is.

        None for other quantities.
        """
        if name not in ("coulomb", "offset"):
            return None, None
        torque = self.drive.parameters[TORQUE]
        return value / torque.step, torque.raw_unit

    # -- work ------------------------------------------------------------------------------------

    def prepare(self, pace: PeriodNeeds) -> Ready:
        """All that comes before the oscillations: first motions, proof of the stop path, design."""
        context, envelope, known = self._first_look()
        stopping = self._prove_stop(context, envelope, known)
        self.mover.widen(self.limits.speed)
        context = replace(context, rest=known.offset)
        return Ready.of(
            self.mover, self.options, context, self.units, envelope, known, stopping, pace
        )

    def torque_steps(self) -> Record:
        """Short pushes both ways at low speed, and nothing else."""
        context, envelope, known = self._first_look()
        self.recorder.phase(f"{STEPS} torque steps, both ways")
        begin = len(self.recorder.samples)
        self.mover.move(torque_steps(self._cautious(context), known), envelope, known.offset)
        taken = self.recorder.samples[begin:]
        return record_of(taken, taken, context.resolution)

    def follow(self, path: TrackingPath) -> TrackingSamples:
        """Follow a path in position mode."""
        envelope = replace(self.envelope, cautious=False)
        return self.mover.follow(
            lambda here: track(self.context, path, here), envelope, self._unseen()
        )

    def _unseen(self) -> Recorder:
        """A recorder of what is no torque experiment, which is watched as well."""
        return Recorder(watcher=self.recorder.watcher)

    # -- first motions ---------------------------------------------------------------------------

    def _first_look(self) -> tuple[Context, Envelope, FirstLook]:
        """The first motions, from rest and with the watchdog proved; what holds after them."""
        held_by = self.axis.mechanics.held_by
        rest = self._holding_torque() if held_by != "friction" else 0.0
        context = replace(self.context, rest=rest)
        watcher = self.recorder.watcher
        watcher.step(AT_REST)
        self.recorder.phase("does the axis stay at rest?")
        noise = self.mover.hold(stand(context), self.envelope, rest)
        context = replace(context, noise=noise)
        watcher.step(FIRST_MOTIONS)
        known = self.mover.move(first_look(self._cautious(context)), self.envelope, rest)
        watcher.friction(known.coulomb, None, None)
        if abs(known.offset) > known.breakaway and held_by == "friction":
            e = self.units.effort
            raise PreflightRefused(
                f"the load of {known.offset:.4g} {e} is more than friction holds "
                f"({known.breakaway:.4g} {e}): the axis falls when the torque goes",
                code="preflight.load",
                hint="declare its brake, counterbalance or fixture in an axis file "
                "([mechanics] held_by)",
            )
        return context, replace(self.envelope, bias=known.offset), known

    def _cautious(self, context: Context, dead_time: float | None = None) -> Context:
        """For motions before the stop path is proved: as slow as the drive's own limit is then."""
        return replace(context, speed=cautious_speed(self.drive, self.limits, dead_time))

    def _holding_torque(self) -> float:
        """Torque that holds the axis, read while the drive holds its position."""
        if not self.drive.tells_torque:
            raise PreflightRefused(
                f"the axis is held by a {self.axis.mechanics.held_by}, but "
                f"{self.drive.profile} does not exchange torque_actual, so the torque that "
                "holds it cannot be known",
                code="preflight.no-torque",
            )
        self.recorder.phase("holding torque: creep up and down in position mode")
        before = len(self.recorder.samples)
        torque = self.mover.follow(
            lambda here: balancing_torque(replace(self.context, start=here)),
            self.envelope,
            self.recorder,
        )
        # position commands are no torques; where it failed they are what one wants to see
        del self.recorder.samples[before:]
        return torque

    def _prove_stop(self, context: Context, envelope: Envelope, known: FirstLook) -> Stopping:
        """Set the axis in motion, stop it by the stop path, and see what braking is certain."""
        p, cycle = self.units.position, self.drive.cycle
        cautious = self._cautious(context, known.dead_time)
        self.recorder.watcher.step(STOP_PATH)
        self.mover.widen(cautious.speed)
        position, speed = self.mover.move(
            run_up(cautious, known), envelope, known.offset, leave_moving=True
        )
        # a drive calls standstill what is slow to it; the axis may coast on
        self.mover.clear_own_fault()
        friction = known.coulomb - abs(known.offset)
        coasting = known.inertia * speed / max(friction, 0.1 * known.coulomb)
        moved = still_moving(self.drive, 1.0 + _COASTING_MARGIN * coasting)
        if moved:
            raise DriveFault(
                "the stop path could not be proved: the drive has no energy any more, and the axis "
                f"still moves ({moved:.3g} {p} between two looks); nothing larger is moved",
                code="stop.coasts",
            )
        distance = abs(self.drive.read(POSITION).si - position)
        delay = known.dead_time + cycle
        counted = max(distance - speed * delay, 0.25 * distance, 1e-12)
        braking = _BRAKING_SHARE * known.inertia * speed**2 / (2 * counted)
        certain = max(braking, friction)
        if not certain > 0 or not speed > 0:
            raise DriveFault(
                f"the stop path could not be proved ({distance:.3g} {p} from "
                f"{speed:.3g} {p}/s); nothing larger is moved",
                code="stop.not-proved",
            )
        self.recorder.detail(
            f"stop path proved: {speed:.3g} {p}/s to rest within {distance:.3g} {p}"
        )
        watchdog = self.drive.watchdog
        silent = watchdog.timeout if watchdog.kind != "none" else 0.0
        reaction = max(_CYCLES_TO_NOTICE * cycle, silent) + delay
        watches = silent if silent > _CYCLES_TO_NOTICE * cycle else 0.0
        return Stopping(known.inertia, known.coulomb, certain, reaction, delay, watches)
