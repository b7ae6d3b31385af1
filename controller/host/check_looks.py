"""The bring-up steps without current: link, emergency stop, encoder, accelerometer, grip, current offset.

The encoder is compared with a distance that the person measures; the accelerometer with gravity, if its axis has a
component of it, and with the encoder while the stylus is shaken. So both scales are known before any current flows.
"""

from math import ceil

import numpy as np

from controller.host.check_state import WINDOW_S, Check
from controller.host.diagnosis import off, sound
from controller.host.motion import Shaken, shaken
from controller.host.rates import remedy
from controller.protocol.messages import STOP_PRESSED
from controller.servo.interface import Fault, State
from transopt.base.signals import STANDARD_GRAVITY_M_S2

LINK_S, LINK_ERROR_S, CLOCK_OFF = 1.0, 0.05, 0.01
SPARE = 2.0  # reserve of the line's rate: frames of few records have more overhead, and nothing may queue
SELDOM_S = 10e-3  # longest time between two records that still shows a hand's motion
CLOCK_S = 10.0  # longest wait for the clock's window of heartbeats to fill
LATE_S = 0.1  # delay of records without loss: a batch, an adapter's latency and a pause of the host
WAY_M = 10e-3  # distance that the person moves the stylus, by a ruler
LEAST_WAY = 0.1  # share of it that must be seen for the stylus to count as moved
UNSTEADY = 0.15  # unsteadiness at rest allowed, as a share of the motion: a wrong scale also scales a hand's tremor
REST_M_S2 = 0.2 * STANDARD_GRAVITY_M_S2  # largest error of the accelerometer at rest
GRAVITY_M_S2 = 0.5 * STANDARD_GRAVITY_M_S2  # least stated reading at rest by which its scale can be judged
SHAKE_S = 1.5
GRIP_ZERO_N, GRIP_HELD_N = 0.2, 0.7
GRIP_STEADY = 0.1  # largest range of a weight's reading, relative
OFFSET_A = 0.05
Verdict = tuple[str, bool]


def link(check: Check) -> Verdict:
    """Check the link: heartbeats, the device's clock against the host's, and the rate of telemetry."""
    session = check.device.session
    check.wait(lambda: bool(check.records), LINK_S)
    carried, damaged = _carried(check)
    words = ""
    if carried < 1.0:
        # The line is too slow for a record of every tick: read fewer; the device buffers a tap and sends it later.
        words = f"; {remedy(check.dt_s, carried)}"
        every = ceil(SPARE / carried) if carried > 0.0 else 0
        if 0 < every * check.dt_s <= SELDOM_S:
            check.look(every)
            # Heartbeats queued behind the records hardly determine the clock: wait until new ones have replaced them.
            check.wait(lambda: bool(check.records) and _is_clock_known(check), CLOCK_S)
            carried, damaged = _carried(check)
            words = f", one record of {every} ticks, and a tap is sent afterwards{words}"
    clock = session.clock
    if clock is None or not check.records:
        return "no heartbeat or no telemetry", False
    lost = round((1.0 - carried) * check.rows(LINK_S))
    seen = f"clock {100 * clock.drift:+.2f} %, known to {1e3 * clock.error_s:.1f} ms"
    seen += f", {lost} records lost, {damaged} frames damaged{words}"
    return seen, _is_clock_known(check) and lost == 0 and damaged == 0


def _is_clock_known(check: Check) -> bool:
    clock = check.device.session.clock
    return clock is not None and abs(clock.drift) <= CLOCK_OFF and clock.error_s <= LINK_ERROR_S


def _carried(check: Check) -> tuple[float, int]:
    """Share of the records that arrived within `LINK_S`, 1 if none was lost or late, and number of damaged frames."""
    before, missed = check.device.session.decoder.bad_frames, check.missed
    first = check.records.newest or 0
    check.device.listen(LINK_S)
    if not check.records:
        return 0.0, 0
    # A device buffers records, so on a slow line they are late before any is missing.
    late_s = LINK_S - ((check.records.newest or 0) - first) * check.dt_s
    lost = check.missed - missed + (check.rows(late_s) if late_s > LATE_S else 0)
    return max(1.0 - lost / check.rows(LINK_S), 0.0), check.device.session.decoder.bad_frames - before


def emergency_stop(check: Check) -> Verdict:
    check.person.asked("press the emergency stop")
    if not check.wait(lambda: check.device.fault is Fault.EMERGENCY_STOP, check.patience_s):
        return f"not pressed within {check.patience_s:g} s", False
    check.person.asked("release the emergency stop")
    check.forget()

    def released() -> bool:
        flags = check.column("flags")
        return flags.size > 0 and not int(flags[-1]) & STOP_PRESSED

    if not check.wait(released, check.patience_s):
        return f"not released within {check.patience_s:g} s", False
    check.device.reset()
    return f"latched, reset to {check.device.state.value}", check.device.state is State.IDLE


def encoder(check: Check) -> Verdict:
    """Compare the encoder with a distance that the person measures."""
    way = WAY_M / check.settings.count_m
    check.person.asked("let the stylus rest near the surface")
    check.forget()
    check.wait(check.at_rest, min(check.patience_s, 5 * WINDOW_S))
    begin = check.mean("encoder_counts")
    if np.isnan(begin):
        return "no telemetry", False
    check.person.asked(f"move the stylus {1e3 * WAY_M:g} mm outwards, away from the surface, by a ruler; rest there")
    check.forget()

    def moved() -> float:
        return check.mean("encoder_counts") - begin

    def there() -> bool:
        return abs(moved()) >= LEAST_WAY * way and check.still(max(check.still_counts, UNSTEADY * abs(moved())))

    check.wait(there, check.patience_s)
    check.note(ruler=moved() / way)
    metres = 1e3 * moved() * check.settings.count_m
    return f"{moved():+.0f} counts, {metres:+.2f} mm of {1e3 * WAY_M:g}", sound(moved() / way)


def accelerometer(check: Check) -> Verdict:
    """Compare the accelerometer at rest with the stated reading, and in motion with the encoder."""
    check.person.asked("let the stylus rest")
    check.forget()
    check.wait(check.at_rest, min(check.patience_s, 5 * WINDOW_S))
    rest, stated = check.mean("acceleration_m_s2"), check.described.accelerometer.rest_m_s2
    seen = f"{rest:+.2f} m/s² at rest"
    if abs(stated) >= GRAVITY_M_S2:
        check.note(gravity=(rest + stated) / stated)
    if not abs(rest) <= REST_M_S2:
        if abs(stated) < GRAVITY_M_S2:
            check.remarks.append(
                f"the accelerometer reads {rest:+.2f} m/s² at rest: if that is gravity, state "
                f"accelerometer.rest_m_s2 = {stated + rest:.2f}"
            )
        return seen, False
    check.person.asked("shake the stylus out and in, by a centimetre, three times a second, until the next request")
    check.forget()
    check.device.listen(SHAKE_S)
    found = _shaken(check)
    while not found.enough and len(check.records) < check.rows(check.patience_s):
        check.device.listen(SHAKE_S)
        found = _shaken(check)
        if len(check.records) == check.records.most:
            break
    check.person.asked("let the stylus rest")
    if not found.enough:
        return f"{seen}; not shaken within {check.patience_s:g} s", False
    check.note(motion=found.ratio)
    seen += f"; shaken {found.encoder_m_s2:.2f} m/s² by the encoder, {found.accelerometer_m_s2:.2f} by it"
    return f"{seen}, correlation {found.correlation:+.2f}", sound(check.found.accelerometer)


def _shaken(check: Check) -> Shaken:
    counts, felt = (check.column(name, 2 * SHAKE_S) for name in ("encoder_counts", "acceleration_m_s2"))
    return shaken(check.every * check.dt_s, counts * check.settings.count_m, felt)


def grip_zero(check: Check) -> Verdict:
    check.person.asked("let go of the stylus, and leave it alone until the next request")
    check.forget()

    def let_go() -> bool:
        grip = check.column("grip_N")
        return grip.size >= check.rows(WINDOW_S) and float(np.abs(grip).max()) <= GRIP_ZERO_N

    done, grip = check.wait(let_go, check.patience_s), check.mean("grip_N")
    if not done:
        check.remarks.append(f"the grip sensor reads {grip:+.2f} N when released: stuck, or state grip.zero_N")
    return f"{check.mean('grip_N'):+.3f} N", done


def grip_hold(check: Check) -> Verdict:
    """Check that the grip sensor responds when held, and its scale if a known weight is given."""
    check.person.asked("hold the stylus firmly, as for a tap, above the surface")
    check.forget()
    most = check.settings.grip_short_N

    def held() -> bool:
        return GRIP_HELD_N <= check.mean("grip_N") <= most

    done = check.wait(held, check.patience_s)
    grip = check.mean("grip_N")
    seen = f"{grip:+.2f} N held"
    if not done:
        reversed_ = grip <= -GRIP_ZERO_N
        check.note(grip=-1.0 if reversed_ else 0.0)
        return f"{seen}: {'reversed' if reversed_ else 'dead or stuck'}", False
    if check.grip_weight_N is None:
        return f"{seen}; its scale is not checked (--grip-weight-g)", True
    weight = check.grip_weight_N
    check.person.asked(
        f"put the weight of {1e3 * weight / STANDARD_GRAVITY_M_S2:g} g on the grip sensor, nothing else"
    )
    check.forget()
    check.device.listen(2 * WINDOW_S)  # time to let go and to put the weight on
    check.forget()

    def steady() -> bool:
        values = check.column("grip_N")
        size = float(np.abs(values).mean()) if values.size else 0.0
        return values.size >= check.rows(WINDOW_S) and float(np.ptp(values)) <= max(GRIP_ZERO_N, GRIP_STEADY * size)

    check.wait(lambda: steady() and sound(check.mean("grip_N") / weight), min(check.patience_s, 10 * WINDOW_S))
    ratio = check.mean("grip_N") / weight
    check.note(grip=ratio)
    return f"{seen}; {check.mean('grip_N'):+.2f} N of {weight:.2f} N with the weight", not off(ratio)


def current_offset(check: Check) -> Verdict:
    check.person.asked("hold the stylus above the surface, still")
    check.need_rest()
    mean_A = check.mean("measured_current_A")
    done = abs(mean_A) <= OFFSET_A
    if not done:
        check.remarks.append(f"the current monitor reads {mean_A:+.2f} A while nothing is commanded")
    return f"{mean_A:+.4f} A", done
