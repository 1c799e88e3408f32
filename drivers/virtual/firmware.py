"""Firmware of the virtual drive: CiA 402 states, loops, limits, brake, watchdog, parameters.

It knows no bus. Adapters read and write its objects by key, in raw integers, and let time pass.
Time is counted in integer nanoseconds, so events fall exactly on cycle boundaries.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from drivers.virtual.axes import VirtualAxis
from drivers.virtual.compensation import TENTH_RPM, compensation
from drivers.virtual.interpolator import SECOND, Interpolator
from drivers.virtual.loops import TICK, Loops, as_delivered
from drivers.virtual.memory import Memory
from drivers.virtual.objects import (
    MODE_CYCLIC_POSITION,
    MODE_CYCLIC_TORQUE,
    MODE_PROFILE_TORQUE,
    MODES,
    objects,
)
from drivers.virtual.states import (
    ERROR_COMMUNICATION,
    ERROR_FOLLOWING,
    ERROR_OVERSPEED,
    DenialReason,
    Denied,
    State,
)

__all__ = ["SECOND", "Firmware"]

_HALF_TURN_OF_I32 = 1 << 31  # a 32-bit position counter rolls over
_SUPERVISION = 1_000_000  # ns: how often the limits are looked at where no loop is closed
_NEVER = 1 << 62
_STORE_TIME = 20_000_000  # ns: the EEPROM is busy
_LONGEST_STOP = SECOND  # ns: then the energy goes anyway
_OVERSPEED = 1.5  # of the motor's speed: then it goes at once
_BRAKE_RELEASE = 50_000_000  # ns
_BRAKE_APPLY = 50_000_000  # ns
_NEAR_SPEED_LIMIT = 0.9 * TENTH_RPM
_REST_SPEED_SHARE = 2e-4  # of the speed limit: slower than this counts as standstill

_GAINS = ("velocity_gain", "integral_time", "position_gain")
_TORQUE_MODES = (MODE_PROFILE_TORQUE, MODE_CYCLIC_TORQUE)


class Firmware:
    """One drive.

    Attributes
    ----------
    now : int
        Simulated time since power-on, ns.
    state : State
    plant : Plant, CompliantPlant or Electronics
    on_emergency : callable(error_code)
        Called when an error comes up (and with 0 when it is reset).
    on_silence : callable()
        Called when the master has fallen silent, whatever the drive makes of it.
    silence_code : int
        Error code for a master that falls silent.
    """

    def __init__(self, axis: VirtualAxis, memory: Memory | None = None) -> None:
        self.axis = axis
        self.memory = memory or Memory(None)
        self.plant = axis.build()
        self.plant.locked = axis.brake
        self.now = 0
        self._state = State.SWITCH_ON_DISABLED
        self._word = 0
        self._enabled = False
        self.error_code = 0
        self.store_busy_until = 0
        self.on_emergency: Callable[[int], None] = lambda code: None
        self.on_silence: Callable[[], None] = lambda: None
        self.silence_code = ERROR_COMMUNICATION
        self._objects = objects(axis)
        self.values = {key: item.default for key, item in self._objects.items()}
        self._recall()
        self.state = State.SWITCH_ON_DISABLED
        self._unit = axis.rated / 1000  # N.m or N of one per mille
        self._resolution = axis.resolution
        self._delay = round(axis.delay * SECOND)
        self._queue: deque[tuple[int, float]] = deque()
        self._requested = 0.0  # torque command after the delay, N.m or N
        self._torque_command = 0.0  # in force at the motor: behind the limits, N.m or N
        self._ramped = 0.0  # torque command behind the slope, N.m or N
        self._limiting = False
        self._timer = _NEVER
        self._on_timer: Callable[[], None] = lambda: None
        self._watched = False
        self._fed = 0
        self._tick_at = 0
        self._energised = False
        self._after_stop = State.SWITCH_ON_DISABLED
        self._loop = self._tuned()
        self._stopping = Loops(*as_delivered(axis))  # the stop does not hang on what a user tunes
        self._path = Interpolator(round(axis.cycle * SECOND))
        self._stop_by = _NEVER
        self._word_before = 0

    def _recall(self) -> None:
        """Take the non-volatile values from memory."""
        for key, value in self.memory.load().items():
            item = self._objects.get(key)
            if item is not None and item.nonvolatile and item.low <= value <= item.high:
                self.values[key] = value

    def restart(self) -> None:
        """Switch off and on again: energy gone, volatile values lost."""
        self._power_off(State.SWITCH_ON_DISABLED)
        self.error_code = 0
        self._watched = False
        self.values = {key: item.default for key, item in self._objects.items()}
        self._recall()
        self._loop = self._tuned()

    def _tuned(self) -> Loops:
        """The loops by the gains that are set."""
        values = self.values
        return Loops(
            values["velocity_gain"] * 1e-6 * self.axis.rated,
            values["integral_time"] * 1e-6,
            values["position_gain"] * 0.01,
        )

    # -- what adapters see -------------------------------------------------------------------------

    @property
    def energised(self) -> bool:
        """Whether the power stage is on."""
        return self._energised

    @property
    def state(self) -> State:
        """Where the power state machine is."""
        return self._state

    @state.setter
    def state(self, state: State) -> None:
        self._state = state
        self._enabled = state is State.OPERATION_ENABLED
        self._word = state.value | 0x0200  # remote
        if state is not State.SWITCH_ON_DISABLED and state is not State.FAULT:
            self._word |= 0x0010  # voltage enabled
        if self._enabled:
            self._word |= 0x1000  # follows the command

    @property
    def statusword(self) -> int:
        """Statusword 6041h."""
        return self._word | 0x0800 if self._limiting else self._word  # internal limit active

    @property
    def position(self) -> int:
        """Position actual value, increments."""
        counts = round(self.plant.position / self._resolution)
        if -_HALF_TURN_OF_I32 <= counts < _HALF_TURN_OF_I32:
            return counts
        return (counts + _HALF_TURN_OF_I32) % (2 * _HALF_TURN_OF_I32) - _HALF_TURN_OF_I32

    @property
    def velocity(self) -> int:
        """Velocity actual value, increments/s."""
        counts = round(self.plant.velocity / self._resolution)
        return max(-_HALF_TURN_OF_I32, min(_HALF_TURN_OF_I32 - 1, counts))

    @property
    def torque(self) -> int:
        """Torque actual value, per mille of rated."""
        if not self._energised or self.axis.torque_seen < 0:
            return 0
        return max(-32768, min(32767, round(self.plant.torque / self._unit)))

    def read(self, key: str) -> int:
        """Raw value of an object; raises Denied."""
        live = _LIVE.get(key)
        if live is not None:
            return live(self)
        try:
            return self.values[key]
        except KeyError:
            raise Denied(DenialReason.NO_OBJECT) from None

    def write(self, key: str, value: int) -> None:
        """Write a raw value; raises Denied."""
        if key in _LIVE:
            raise Denied(DenialReason.READ_ONLY)
        item = self._objects.get(key)
        if item is None:
            raise Denied(DenialReason.NO_OBJECT)
        if not item.writable:
            raise Denied(DenialReason.READ_ONLY)
        if not item.low <= value <= item.high:
            raise Denied(DenialReason.RANGE)
        if key == "mode":
            self._set_mode(value)
            return
        self.values[key] = value
        if key == "controlword":
            self._control(value)
        elif key == "torque_target":
            self._take_torque(value)
        elif key == "position_target":
            self._take_position(value)
        elif key in _GAINS:
            tuned = self._tuned()
            tuned.integral, tuned.clamped = self._loop.integral, self._loop.clamped
            self._loop = tuned

    def command_torque(self, per_mille: int) -> None:
        """Cyclic torque command: the short way of writing `torque_target`."""
        self.values["torque_target"] = per_mille
        self._take_torque(per_mille)

    def store(self) -> None:
        """Save the non-volatile objects; busy for a while; raises Denied while enabled."""
        if self._energised:
            raise Denied(DenialReason.STATE)
        kept = {key: self.values[key] for key, item in self._objects.items() if item.nonvolatile}
        try:
            self.memory.save(kept)
        except OSError:
            raise Denied(DenialReason.STATE) from None
        self.store_busy_until = self.now + _STORE_TIME

    def feed_watchdog(self) -> None:
        """The master was heard; an error of its silence that was no fault is gone."""
        if not self._watched and self.error_code == self.silence_code:
            self._heard_again()
        self._watched = True
        self._fed = self.now

    def _heard_again(self) -> None:
        if self.state not in (State.FAULT, State.FAULT_REACTION_ACTIVE):
            self._report(0)

    def unwatch(self) -> None:
        """The master said good-bye: the watchdog waits for the next one."""
        self._watched = False

    def trip(self, code: int) -> None:
        """A fault came up: brake with the quick stop ramp, then de-energise."""
        if self.state in (State.FAULT, State.FAULT_REACTION_ACTIVE):
            return
        self._report(code)
        if self._energised:
            self.state = State.FAULT_REACTION_ACTIVE
            self._begin_stop(State.FAULT)
        else:
            self.state = State.FAULT

    def communication_lost(self, code: int) -> None:
        """React to a silent master as the abort connection option code says (CiA 402, 6007h)."""
        self._watched = False
        if code == self.silence_code:
            self.on_silence()
        option = self.values["abort_connection_option"]
        if option == 0 or not self._energised or self.state is State.FAULT_REACTION_ACTIVE:
            return
        if option == 1:
            self.trip(code)
        elif option == 2:
            self._report(code)
            self._power_off(State.SWITCH_ON_DISABLED)
        else:
            self._report(code)
            self._quick_stop()

    # -- power state machine -----------------------------------------------------------------------

    def _control(self, word: int) -> None:
        state = self.state
        rises = word & ~self._word_before & 0x80  # fault reset is an edge (CiA 402-2, 8.4.1.3)
        self._word_before = word
        if state is State.FAULT_REACTION_ACTIVE:
            return
        if state is State.FAULT:
            if rises:
                self._report(0)
                self.state = State.SWITCH_ON_DISABLED
            return
        if not word & 0x02:  # disable voltage
            self._power_off(State.SWITCH_ON_DISABLED)
        elif not word & 0x04:  # quick stop
            if state is State.OPERATION_ENABLED or self._energised:
                self._quick_stop()
            elif state is not State.QUICK_STOP_ACTIVE:
                self.state = State.SWITCH_ON_DISABLED
        elif state is State.QUICK_STOP_ACTIVE:
            return
        elif word & 0x0F in (0x06, 0x0E):  # shutdown
            if state is State.OPERATION_ENABLED:
                self._begin_stop(State.READY_TO_SWITCH_ON)
            elif self._energised:
                self._power_off(State.READY_TO_SWITCH_ON)
            else:
                self.state = State.READY_TO_SWITCH_ON
        elif word & 0x0F == 0x07:  # switch on, or disable operation
            if state is State.OPERATION_ENABLED:
                self._begin_stop(State.SWITCHED_ON)
            elif state is State.READY_TO_SWITCH_ON:
                self.state = State.SWITCHED_ON
        elif word & 0x0F == 0x0F and state is State.SWITCHED_ON and not self._energised:
            self._enable()

    def _enable(self) -> None:
        if self.values["mode"] not in MODES:
            return
        self._energised = True
        self._queue.clear()
        self._hold_here()
        self._ramped = self._clamped(self.values["torque_target"])
        self._requested = self._torque_command = self._ramped
        if self.axis.brake:
            self._start_timer(_BRAKE_RELEASE, self._operate)
        else:
            self._operate()

    def _operate(self) -> None:
        self.plant.locked = False
        self.state = State.OPERATION_ENABLED

    def _quick_stop(self) -> None:
        option = self.values["quick_stop_option"]
        if option == 0:
            self._power_off(State.SWITCH_ON_DISABLED)
            return
        self.state = State.QUICK_STOP_ACTIVE
        self._begin_stop(State.SWITCH_ON_DISABLED if option < 5 else State.QUICK_STOP_ACTIVE)

    def _begin_stop(self, after: State) -> None:
        """Decelerate by the velocity loop with all the torque there is; then go to `after`."""
        if self.state is State.OPERATION_ENABLED:
            self.state = State.QUICK_STOP_ACTIVE
        self._after_stop = after
        self._queue.clear()
        self._timer = _NEVER
        self._tick_at = self.now
        self._stop_by = self.now + _LONGEST_STOP
        self._stopping.reset(0.0)

    def _at_standstill(self) -> None:
        if self._after_stop is State.QUICK_STOP_ACTIVE:
            return
        if self.axis.brake:
            if self._timer == _NEVER:
                self.plant.locked = True
                self._start_timer(_BRAKE_APPLY, lambda: self._power_off(self._after_stop))
        else:
            self._power_off(self._after_stop)

    def _power_off(self, state: State) -> None:
        was_energised = self._energised
        self.state = state
        self._energised = False
        self._queue.clear()
        self._requested = self._torque_command = self._ramped = 0.0
        self._limiting = False
        if was_energised:  # else the brake is closing, or closed
            self._timer = _NEVER
            if self.axis.brake and not self.plant.locked:
                self._start_timer(_BRAKE_APPLY, self._close_brake)

    def _close_brake(self) -> None:
        self.plant.locked = True

    def _start_timer(self, duration: int, action: Callable[[], None]) -> None:
        self._timer = self.now + duration
        self._on_timer = action

    def _report(self, code: int) -> None:
        self.error_code = code
        self.on_emergency(code)

    def _set_mode(self, mode: int) -> None:
        if mode not in MODES and mode != 0:
            raise Denied(DenialReason.RANGE)
        if self.state is State.OPERATION_ENABLED and mode != self.values["mode"]:
            raise Denied(DenialReason.STATE)
        self.values["mode"] = mode

    # -- set-points --------------------------------------------------------------------------------

    def _clamped(self, per_mille: int) -> float:
        limit = self.values["max_torque"]
        if -limit <= per_mille <= limit:
            self._limiting = False
            return per_mille * self._unit
        self._limiting = True
        return (limit if per_mille > 0 else -limit) * self._unit

    def _take_torque(self, per_mille: int) -> None:
        if self._enabled:
            torque = self._clamped(per_mille)
            if self._delay:
                self._queue.append((self.now + self._delay, torque))
            else:
                self._requested = self._torque_command = torque

    def _take_position(self, increments: int) -> None:
        self._path.take(increments * self._resolution, self.now)

    def _hold_here(self) -> None:
        self._path.hold(self.plant.position, self.now)
        self.values["position_target"] = self.position
        self._tick_at = self.now
        self._loop.reset(0.0)

    # -- time --------------------------------------------------------------------------------------

    def advance(self, duration: int) -> None:
        """Let `duration` ns pass."""
        end = self.now + duration
        queue = self._queue
        values = self.values
        if (
            duration <= _SUPERVISION
            and self._enabled
            and values["mode"] == MODE_CYCLIC_TORQUE
            and self._timer > end
            and (not queue or queue[0][0] >= end)
            and not (self._watched and self._fed + values["watchdog_time"] * 1_000_000 <= end)
            and abs(self.plant.velocity) <= _NEAR_SPEED_LIMIT * values["max_speed"]
        ):
            # nearly every cycle of an experiment: one torque, and nothing else happens in it
            self.plant.advance(duration / SECOND, self._torque_command)
            self.now = end
            if queue and queue[0][0] <= end:
                self._requested = self._torque_command = queue.popleft()[1]
            return
        while True:
            until = end
            if queue and queue[0][0] < until:
                until = queue[0][0]
            until = min(until, self._timer)
            watchdog = self.values["watchdog_time"] * 1_000_000 if self._watched else 0
            if watchdog and self._fed + watchdog < until:
                until = max(self._fed + watchdog, self.now)
            if self._energised:
                if self._needs_loop():
                    if self.now >= self._tick_at:
                        self._tick()
                    until = min(until, self._tick_at)
                else:
                    until = min(until, self.now + _SUPERVISION)
            if until > self.now:
                self.plant.advance((until - self.now) / SECOND, self._torque_command)
                self.now = until
            if queue and queue[0][0] <= self.now:
                self._requested = self._torque_command = queue.popleft()[1]
            if self._timer <= self.now:
                self._timer = _NEVER
                self._on_timer()
            if watchdog and self.now - self._fed >= watchdog:
                self.communication_lost(self.silence_code)
            if self._energised and abs(self.plant.velocity) > _OVERSPEED * self.axis.speed:
                self._report(ERROR_OVERSPEED)
                self._power_off(State.FAULT)
            if self.now >= end:
                return

    def _needs_loop(self) -> bool:
        """Whether the drive's own loops are at work; else the torque is constant."""
        if not self._enabled:
            return self._state in (State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE)
        if self.values["mode"] == MODE_CYCLIC_TORQUE:
            return abs(self.plant.velocity) > _NEAR_SPEED_LIMIT * self.values["max_speed"]
        return True

    @property
    def _speed_limit(self) -> float:
        return self.values["max_speed"] * TENTH_RPM

    def _tick(self) -> None:
        """One period of the drive's control loops."""
        self._tick_at = self.now + TICK
        if self.state is not State.OPERATION_ENABLED:
            self._tick_stop()
            return
        mode = self.values["mode"]
        if mode in _TORQUE_MODES:
            self._tick_torque(mode)
            return
        plant, loop, limit = self.plant, self._loop, self._speed_limit
        if mode == MODE_CYCLIC_POSITION:
            target = self.values["position_target"] * self._resolution
            velocity = self._path.advance(target, self.now)
            error = self._path.command - plant.position
            if abs(error) > self.values["following_window"] * self._resolution:
                self.trip(ERROR_FOLLOWING)
                return
            wanted = velocity + loop.position_gain * error
        else:
            velocity = self.values["velocity_target"] * self._resolution
            wanted = velocity
        wanted = max(-limit, min(limit, wanted))
        torque = loop.velocity_control(wanted, plant.velocity) + compensation(
            self.values, velocity, self.axis.rated
        )
        self._set_limited(torque)

    def _tick_torque(self, mode: int) -> None:
        if mode == MODE_PROFILE_TORQUE:
            most = self.values["torque_slope"] * self._unit * (TICK / SECOND)
            target = self._clamped(self.values["torque_target"])
            self._ramped += max(-most, min(most, target - self._ramped))
            self._queue.clear()
            self._requested = self._ramped
        # speed limiter: no more torque along the motion than leads up to the limit
        direction = 1 if self.plant.velocity > 0 else -1
        room = self._stopping.velocity_gain * (self._speed_limit - abs(self.plant.velocity))
        along = min(direction * self._requested, room)
        self._set_limited(direction * along)
        self._limiting = self._limiting or along < direction * self._requested

    def _tick_stop(self) -> None:
        if self.now >= self._stop_by:  # it brakes in vain
            self._power_off(self._after_stop)
            return
        if abs(self.plant.velocity) <= _REST_SPEED_SHARE * self.axis.speed:
            self._at_standstill()
            if not self._energised:
                return
        self._set_limited(self._stopping.velocity_control(0.0, self.plant.velocity))

    def _set_limited(self, torque: float) -> None:
        limit = self.values["max_torque"] * self._unit
        clamped = max(-limit, min(limit, torque))
        self._limiting = clamped != torque
        self._loop.clamped = self._stopping.clamped = clamped != torque
        self._torque_command = clamped


_LIVE: dict[str, Callable[[Firmware], int]] = {
    "statusword": lambda drive: drive.statusword,
    "error_code": lambda drive: drive.error_code,
    "position_actual": lambda drive: drive.position,
    "velocity_actual": lambda drive: drive.velocity,
    "torque_actual": lambda drive: drive.torque,
    "mode_display": lambda drive: drive.values["mode"],
    "store_status": lambda drive: 1 if drive.now < drive.store_busy_until else 0,
}
