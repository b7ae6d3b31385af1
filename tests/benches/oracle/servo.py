"""The servo: sensors in, command and events out, once per servo period.

    IDLE     no command                                     arm() -> ARMED
    ARMED    feedback                                       contact or excite() -> PLAYING, disarm() -> IDLE
    PLAYING  feedback and transient                         end -> ARMED, disarm() -> IDLE
    FAULT    no command, from the tick on that saw it       reset() -> IDLE once the cause is gone

Any state goes to FAULT by the table in `faults`. A second contact while a transient plays is not played: the
recording that plays holds the real object's own rebounds, and two transients on top of each other are certified by
nobody. It is counted as chatter, and so is a contact before the stylus has been off the surface for a while.

Where the settings say that the host starts the waveform, an excitation, contacts are not looked at and there is no
feedback; everything else is as in a tap.

`step` uses plain floats and integers, whose sequence of operations firmware can repeat bit by bit. Only at a
contact arrays are touched, to blend the waveform.
"""

import math
from collections import deque

from controller.servo.interface import Event, Fault, Notice, Output, Readings, State
from controller.servo.settings import Settings
from controller.waveforms.bank import Bank
from tests.benches.oracle.approach import Approach, Touch, Trigger
from tests.benches.oracle.blend import Play, blend_at
from tests.benches.oracle.faults import FAULTS, Watch
from tests.benches.oracle.guard import Guard
from transopt.plant.discretise import split_delay

SATURATED_A = 1e-3  # a cut below this is rounding of the waveforms, not worth telling
NOTHING: tuple[Event, ...] = ()


class Servo:
    """One degree of freedom, one bank of transients.

    Attributes
    ----------
    state, fault : what it does; the fault it latched, None without.
    counts : how often each notice was given.
    play : what was played last, None before anything. cooled : the part of its cool command in the blend that
        the heat allowed. scale : how much of that blend it allowed, below 0 with the other sign.
    expected_A : current of the amplifier model at the coming switching instant.
    awaited_A : of the last ticks, the oldest first: the amplifier is late by so many whole ones, so that the oldest
        is what the coming reading is compared with.
    gain : in force, follows `wanted_gain`.
    """

    def __init__(self, settings: Settings, bank: Bank) -> None:
        s = settings
        self.settings, self.bank = s, bank
        self.state = State.IDLE
        self.fault: Fault | None = None
        self.counts = dict.fromkeys(Notice, 0)
        self.play: Play | None = None
        self.scale, self.cooled = 0.0, 0.0
        self.gain, self.wanted_gain, self.expected_A = 1.0, 1.0, 0.0
        self.guard = None if s.coil is None else Guard(s.coil, s.dt_s, s.withhold_K, s.least_scale)
        self.watch = Watch(s, self.guard)
        self.approach = Approach(
            s.dt_s,
            s.lead_s,
            count_m=s.count_m,
            surface_counts=s.surface_counts,
            window_ticks=s.window_ticks,
            least_speed_m_s=s.least_speed_m_s,
        )
        self._trigger = Trigger(s.count_m, s.touch_height_m, s.rearm_height_m, s.ticks(s.rearm_s))
        amplifier, wall = s.amplifier, s.wall
        rate = math.inf if amplifier is None else amplifier.rate_rad_s * s.dt_s
        self._decay = math.exp(-rate)
        # Decay in a tick of the fastest and the slowest amplifier that may be there.
        self._fast, self._slow = (math.exp(-rate * (1.0 + sign * s.amplifier_tolerance)) for sign in (1.0, -1.0))
        late_ticks, _ = split_delay(s.delay_s, s.dt_s)  # whole servo periods of the amplifier's delay
        self.awaited_A = deque([0.0] * (late_ticks + 1), maxlen=late_ticks + 1)
        self._least_A = self._most_A = 0.0  # between these the current is at the coming switching instant
        # Coefficients of the feedback's prefilter (`plant.amplifier.prefilter_coefficients`).
        self._now, self._before = 1 / (1 - self._decay), -self._decay / (1 - self._decay)
        self._slew_A = None if s.slew_limit_A_per_s is None else s.slew_limit_A_per_s * s.dt_s
        self._gain_step = s.gain_rate_1_s * s.dt_s
        self._smoothing = 0.0 if wall is None else math.exp(-2 * math.pi * wall.derivative_filter_Hz * s.dt_s)
        late = 0 if wall is None else wall.latency_ticks
        # What was read in the last ticks, a ring: the law answers the oldest.
        self._ring_z, self._ring_v = [0.0] * (late + 1), [0.0] * (late + 1)
        self._ring_next, self._z, self._v, self._read = 0, 0.0, 0.0, False
        self._samples = [0.0]
        self._index, self._part, self._last = 0, 0.0, 0
        self._engaged = self._was_saturated = self._held = False
        self._latched: tuple[Fault, ...] = ()
        self._earlier_A = self._transient_A = self._command_A = 0.0

    # What the host may ask for, between two ticks.

    def arm(self) -> bool:
        """From IDLE; False in FAULT. The wall pushes only after the stylus has once been above the surface."""
        if self.state is State.IDLE:
            self.state, self._engaged, self.gain = State.ARMED, False, self.wanted_gain
            self._earlier_A = 0.0
            self._trigger.restart()
        return self.state is not State.FAULT

    def disarm(self) -> None:
        """To IDLE, with no command from the next tick on; a fault stays."""
        if self.state is not State.FAULT:
            self.state = State.IDLE
            self._silence()

    def excite(self, *, negative: bool = False) -> bool:
        """From ARMED: play the one waveform from the coming tick on; False if it may not be played now.

        The heat allows all of it or none: scaled it would not be the excitation that was asked for.
        """
        bank, guard = self.bank, self.guard
        if self.state is not State.ARMED or not self.settings.host_starts:
            return False
        play = blend_at(bank, bank.speeds_m_s[0], bank.grips_N[0])
        if play.silent:
            return False
        if guard is not None and guard.scale(play.transient_A, play.feedback_A, len(play.samples_A) + 1) < 1.0:
            return False
        self.play, self.scale, self.cooled = play, -1.0 if negative else 1.0, 0.0
        self._held = not self._loose()
        self._start(play.samples_A, 0.0)
        return True

    def reset(self) -> bool:
        """Leave FAULT for IDLE if no cause remained at the last tick; whether no fault is latched any more."""
        if self.state is State.FAULT:
            # What was latched must be gone; of the rest, whatever would trip again at once.
            if any((rule.remains if rule.fault in self._latched else rule.trips)(self.watch) for rule in FAULTS):
                return False
            self.state, self.fault, self._latched = State.IDLE, None, ()
            self.approach.restart()
        return True

    def set_gain(self, gain: float) -> None:
        """Scale of transient and feedback together, 0 to 1; anything else goes to the nearer end, NaN to 0."""
        self.wanted_gain = min(gain, 1.0) if gain > 0.0 else 0.0

    # One servo period.

    def step(self, readings: Readings) -> Output:
        """The command that answers one tick's readings, to be held until the next tick."""
        watch, guard, tick = self.watch, self.guard, readings.tick
        playing = self.state is State.PLAYING
        watch.step(readings, self.awaited_A[0], self._transient_A, playing, playing and self._held)
        if guard is not None:
            # The larger of the two: a sensor that reads low must not let the coil burn, nor one that reads nothing.
            measured = watch.over_current_A if watch.bad_current else abs(watch.current_A)
            expected = abs(self.expected_A)
            guard.step(measured if measured > expected else expected)
        self._measure()
        events = NOTHING
        transient = feedback = command = 0.0
        if self.state is State.FAULT:
            events = self._more_faults(tick)
            watch.forget()
        else:
            for rule in FAULTS:
                if rule.trips(watch):
                    events = self._fail(tick)
                    break
            else:
                if self.state is not State.IDLE:
                    events = self._touch(tick)
                    self._follow_gain()
                    wanted = self.gain * self._law()
                    feedback = self._now * wanted + self._before * self._earlier_A
                    if self.state is State.PLAYING:
                        transient, ended = self._next_sample()
                        if ended:
                            self.state = State.ARMED
                            events = self._note(events, tick, Notice.FINISHED)
                    command = transient + feedback
                    limited = self._limited(command)
                    cut = command - limited
                    if cut != 0.0:
                        # Remember the feedback current that the cut command makes, not the wanted one.
                        applied = limited - transient
                        wanted = (applied - self._before * self._earlier_A) / self._now
                        command = limited
                    self._earlier_A = wanted
                    events = self._saturation(tick, cut, events)
        self._transient_A, self._command_A = transient, command
        self._expect(command)
        winding = math.nan if guard is None else guard.winding_C
        return Output(command, self.state, transient, feedback, winding, events)

    def _measure(self) -> None:
        """Position, filtered velocity and approach from the last sound reading."""
        s, watch = self.settings, self.watch
        z = (watch.counts - s.surface_counts) * s.count_m
        if not self._read:
            # Before the first reading the stylus stood still where it is.
            self._z, self._read = z, True
            for j in range(len(self._ring_z)):
                self._ring_z[j] = z
        a = self._smoothing
        self._v = a * self._v + (1 - a) * (z - self._z) / s.dt_s
        self._z = z
        self._ring_z[self._ring_next], self._ring_v[self._ring_next] = z, self._v
        self._ring_next = self._ring_next + 1 if self._ring_next + 1 < len(self._ring_z) else 0
        self.approach.step(watch.counts)

    def _law(self) -> float:
        """The wall's feedback current: seed Eq. 9, pushes below the surface, never pulls."""
        wall = self.settings.wall
        z, v = self._ring_z[self._ring_next], self._ring_v[self._ring_next]
        if z >= 0.0:
            self._engaged = True
            return 0.0
        if wall is None or not self._engaged:
            return 0.0
        wanted = -(wall.stiffness_N_m * z + wall.damping_N_s_m * v) / wall.force_per_current_N_A
        return wanted if wanted > 0.0 else 0.0

    def _touch(self, tick: int) -> tuple[Event, ...]:
        """Look for a contact, and start a transient if there is one to play."""
        approach, watch, guard = self.approach, self.watch, self.guard
        if self.settings.host_starts:
            return NOTHING
        touch = self._trigger.step(self._z, approach.speed_m_s, approach.phase)
        if touch is Touch.NOTHING:
            return NOTHING
        speed, grip = approach.speed_m_s, watch.grip_N
        if touch is Touch.CHATTER or self.state is State.PLAYING:
            return self._note(NOTHING, tick, Notice.CONTACT_CHATTER, speed, grip)
        play = blend_at(self.bank, speed, grip)
        if play.silent or self._loose():
            return self._note(NOTHING, tick, Notice.NO_GRIP, speed, grip)
        scale, cooled = 1.0, 0.0
        if guard is not None:
            ticks = len(play.samples_A) + 1
            scale, cooled = guard.allowed(play.transient_A, play.cool_transient_A, play.feedback_A, ticks)
        if scale <= 0.0:
            return self._note(NOTHING, tick, Notice.TOO_HOT_TO_PLAY, speed, grip)
        events = self._note(NOTHING, tick, Notice.CONTACT, speed, grip)
        if play.out_of_grid and self._outside(speed, grip):
            events = self._note(events, tick, Notice.OUT_OF_GRID, speed, grip)
        if scale < 1.0 or cooled > 0.0:
            events = self._note(events, tick, Notice.SCALED_FOR_HEAT, speed, grip, scale, cooled)
        self.play, self.scale, self.cooled, self._held = play, scale, cooled, True
        if play.samples_A:
            self._start(play.blended(cooled), approach.phase)
        return events

    def _loose(self) -> bool:
        """Whether the stylus is not held, or too loosely to start."""
        s, watch = self.settings, self.watch
        return watch.has_grip and not watch.raw_grip_N >= s.grip_min_N + s.grip_margin_N

    def _outside(self, speed_m_s: float, grip_N: float) -> bool:
        """Whether a contact lies outside the grid by more than the sensors are worth, where the grid is asked."""
        s, speeds, grips = self.settings, self.bank.speeds_m_s, self.bank.grips_N
        slack = s.grid_slack * speed_m_s
        if not speeds[0] - slack <= speed_m_s <= speeds[-1] + slack:
            return True
        return self.bank.by_grip and not grips[0] - s.grid_slack_N <= grip_N <= grips[-1] + s.grid_slack_N

    def _start(self, samples_A: list[float], phase: float) -> None:
        """Play from `phase` ticks after c_0: sample j at tick j + part late, blended with the one before it."""
        self._samples = [0.0, *samples_A, 0.0]
        self._index = math.ceil(phase)
        self._part = self._index - phase
        self._last = len(samples_A)
        self.state = State.PLAYING

    def _next_sample(self) -> tuple[float, bool]:
        """Transient command of this tick, and whether it was the last."""
        j = self._index
        if j > self._last:
            return 0.0, True
        part = self._part
        value = self.scale * self.gain * ((1.0 - part) * self._samples[j + 1] + part * self._samples[j])
        self._index = j + 1
        return value, j == self._last

    def _limited(self, command_A: float) -> float:
        """The nearest command inside the slew limit, the command's range and, above all, the current limit.

        The current at the coming switching instant, and by monotony all the way to it, is e i + (1 - e) c; it comes
        closest to the limit with the fastest amplifier and the current that is nearest to it.
        """
        s, e = self.settings, self._fast
        limited = command_A
        if self._slew_A is not None:
            limited = _within(limited, self._command_A - self._slew_A, self._command_A + self._slew_A)
        high = (s.current_limit_A - e * self._most_A) / (1.0 - e)
        low = (-s.current_limit_A - e * self._least_A) / (1.0 - e)
        limited = _within(limited, low, high)
        return _within(limited, -s.command_limit_A, s.command_limit_A)

    def _expect(self, command_A: float) -> None:
        """Move the current on to the coming switching instant: as the model has it, and its bounds.

        The upper bound rises with the fastest amplifier and falls with the slowest, the lower one the other way.
        """
        self.expected_A = self._decay * self.expected_A + (1.0 - self._decay) * command_A
        self.awaited_A.append(self.expected_A)
        most = self._fast if command_A > self._most_A else self._slow
        least = self._fast if command_A < self._least_A else self._slow
        self._most_A = most * self._most_A + (1.0 - most) * command_A
        self._least_A = least * self._least_A + (1.0 - least) * command_A

    def _follow_gain(self) -> None:
        self.gain = _within(self.wanted_gain, self.gain - self._gain_step, self.gain + self._gain_step)

    def _saturation(self, tick: int, cut_A: float, events: tuple[Event, ...]) -> tuple[Event, ...]:
        """Tell once per run of cut ticks."""
        saturated = abs(cut_A) > SATURATED_A
        if saturated and not self._was_saturated:
            events = self._note(events, tick, Notice.COMMAND_SATURATED)
        self._was_saturated = saturated
        return events

    def _note(
        self,
        events: tuple[Event, ...],
        tick: int,
        notice: Notice,
        speed_m_s: float = math.nan,
        grip_N: float = math.nan,
        scale: float = math.nan,
        cooled: float = math.nan,
    ) -> tuple[Event, ...]:
        self.counts[notice] += 1
        return (*events, Event(tick, notice, speed_m_s, grip_N, scale, cooled))

    def _fail(self, tick: int) -> tuple[Event, ...]:
        tripped = [rule.fault for rule in FAULTS if rule.trips(self.watch)]
        self.state, self.fault, self._latched = State.FAULT, tripped[0], tuple(tripped)
        self._silence()
        return tuple(Event(tick, fault) for fault in tripped)

    def _more_faults(self, tick: int) -> tuple[Event, ...]:
        """What goes wrong besides while in FAULT: latched and told too, since it bars the reset."""
        more = tuple(r.fault for r in FAULTS if r.fault not in self._latched and r.trips(self.watch))
        if not more:
            return NOTHING
        self._latched += more
        return tuple(Event(tick, fault) for fault in more)

    def _silence(self) -> None:
        self._earlier_A = self._transient_A = self._command_A = 0.0
        self._was_saturated = False
        self.watch.forget()


def _within(value: float, low: float, high: float) -> float:
    return low if value < low else (high if value > high else value)
