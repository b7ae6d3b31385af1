"""The steps of the bring-up check in which a current flows: small pulses, then a tap or a sweep at a gain of 0.1."""

import numpy as np

from controller.host.check_looks import Verdict
from controller.host.check_state import Check, FailedError
from controller.host.diagnosis import sound
from controller.host.pulses import pairs_of
from controller.protocol.capacity import REST_BETWEEN_PULSES_S, TRIAL_GAIN
from controller.protocol.codes import LinkNotice
from controller.protocol.events import Happened
from controller.protocol.messages import PULSE_SOUND, TRIAL_FINISHED
from controller.record.played import PlayedTap, played_tap
from controller.record.recorder import Recorder
from controller.servo.interface import Notice

MEASURED_PAIRS = 4  # pairs of single pulses that are measured if no library predicts them
SLACK_S = 0.5  # waiting time for events beyond the duration of what the device plays
AROUND_S = (0.03, 0.06)  # time recorded at every tick before and after a contact, for the comparison


def pulses(check: Check) -> Verdict:
    """Play pairs of pulses of both signs, so small that they do no harm even with the wrong sign.

    The device plays and judges them itself: without its own positive verdict it does not arm, whatever a host sends.
    """
    check.person.asked("hold the stylus above the surface, still: it will tremble")
    check.need_rest()
    if not check.settings.pulse_grip_N:
        _measure(check)
    s, pairs = check.settings, pairs_of(check.described)
    begin = len(check.happened)
    check.device.pulse(s.pulse_A, s.pulse_ticks, pairs)
    longest_s = 2 * pairs * (s.pulse_ticks * s.dt_s + REST_BETWEEN_PULSES_S)
    if check.wait_for(LinkNotice.PULSE_ENDED, begin, longest_s + SLACK_S) is None:
        raise FailedError("the pulses were cut")
    found = check.device.evidence()
    check.note(current=found.current_ratio, acceleration=found.acceleration_ratio, path=found.path_ratio)
    ratios = {
        "current": found.current_ratio,
        "acceleration": found.acceleration_ratio,
        "path": found.path_ratio,
    }
    seen = ", ".join(f"{name} {ratio:+.2f}" for name, ratio in ratios.items() if not np.isnan(ratio))
    stopped = "" if found.pulses == 2 * pairs else f" of {2 * pairs}, the last one wrong"
    return f"{found.pulses} pulses{stopped}: {seen} of what was asked and predicted", bool(found.bits & PULSE_SOUND)


def _measure(check: Check) -> None:
    """Measure the response to a few single pulses and use it as the prediction, since no library gives one.

    Raises
    ------
    FailedError : the current or the acceleration is that of a faulty device.
    """
    s = check.settings
    if check.take_measured is None or not s.has_accelerometer:
        raise FailedError("nothing predicts the pulse: give a library of this device, or one guessed from datasheets")
    found: list[tuple[float, float]] = []
    for sign in (1, -1) * MEASURED_PAIRS:
        one = _single(check, sign * s.pulse_A)
        if one is None:
            raise FailedError("telemetry was lost while pulses were measured")
        found.append(one)
        # No further pulse follows a faulty response.
        _need_sound(check, *one)
    current, acceleration = (float(np.mean(values)) for values in zip(*found, strict=True))
    check.note(current=current)
    check.settings = check.take_measured(acceleration)


def _need_sound(check: Check, current: float, acceleration: float) -> None:
    """
    Raises
    ------
    FailedError : the ratio of current to command, or the acceleration [m/s^2 per A], is that of a faulty device.
    """
    if sound(current) and acceleration > 0:
        return
    check.note(current=current)
    if sound(current):
        check.remarks.append("the stylus goes inwards by a current outwards: exchange the motor's leads")
    raise FailedError(f"current {current:+.2f} of what was asked, acceleration {acceleration:+.1f} m/s² per A")


def _single(check: Check, size_A: float) -> tuple[float, float] | None:
    """Current over command, and acceleration per ampere [m/s^2], of one pulse; None if telemetry was lost."""
    s, wanted, begin = check.settings, check.settings.pulse_ticks, len(check.happened)
    check.device.pulse(size_A, wanted)
    with check.every_tick():
        end = check.wait_for(LinkNotice.PULSE_ENDED, begin, REST_BETWEEN_PULSES_S + wanted * check.dt_s + SLACK_S)
        if end is None:
            raise FailedError("the pulse was cut")
        check.catch_up(end.tick + s.pulse_skip_ticks)
        return _of_single(check, size_A)


def _of_single(check: Check, size_A: float) -> tuple[float, float] | None:
    s, wanted = check.settings, check.settings.pulse_ticks
    records, before = check.records, check.ticks(REST_BETWEEN_PULSES_S / 2)
    latest = np.flatnonzero(records.column("command_A"))[-wanted:]
    if latest.size < wanted or latest[-1] - latest[0] != wanted - 1 or latest[0] < before:
        return None
    first = int(latest[0])
    current = records.column("measured_current_A")[first - before : first + wanted]
    felt = records.column("acceleration_m_s2")[first - before :]
    late = current[before + wanted // 2 :].mean() - current[:before].mean()
    begin = before + s.pulse_skip_ticks
    pushed = felt[begin : begin + s.pulse_push_ticks].mean() - felt[:before].mean()
    return float(late / size_A), float(pushed / size_A)


def trial_sweep(check: Check) -> Verdict:
    check.person.asked("hold the stylus, or leave it alone, still: it will tremble for a moment")
    check.need_rest()
    begin = len(check.happened)
    check.device.arm(TRIAL_GAIN, trial=True)
    try:
        check.device.start()
        done = check.wait_for(Notice.FINISHED, begin, check.patience_s) is not None
    finally:
        check.device.disarm()
    return "played to its end" if done else "not played to its end", done


def trial_tap(check: Check) -> Verdict:
    """Play a tap at a gain of 0.1 and compare it with the library's prediction."""
    check.person.asked("hold the stylus above the surface, still")
    s = check.settings
    least_N = s.grip_min_N + s.grip_margin_N

    def held() -> bool:
        z = (check.column("encoder_counts") - s.surface_counts) * s.count_m
        firm = s.assumed_grip_N is not None or float(check.column("grip_N").min(initial=np.inf)) > least_N
        return check.at_rest() and firm and float(z.min()) > s.rearm_height_m

    check.forget()
    if not check.wait(held, check.patience_s):
        return f"not held still above the surface within {check.patience_s:g} s", False
    begin = len(check.happened)
    recorder = Recorder(None, check.dt_s, s.count_m, s.surface_counts, around_s=AROUND_S)
    with check.every_tick(check.ticks(AROUND_S[0])), check.device.heard_by(recorder.take):
        finished = _tapped(check, begin)
        contact = check.came(Notice.CONTACT, begin)
        if contact is not None:
            check.catch_up(contact.tick + check.ticks(AROUND_S[1]))
    if contact is None:
        seen = ", ".join(dict.fromkeys(event.what.value for event in check.happened[begin:]))
        return f"no contact within {check.patience_s:g} s" + (f": {seen}" if seen else ""), False
    seen = f"contact at {contact.speed_m_s:.3f} m/s, {contact.grip_N:.2f} N"
    if finished is None:
        return f"{seen}, not played to its end", False
    words, good = _as_predicted(check, recorder)
    found = check.device.evidence()
    check.note(speed=found.speed_ratio)
    if not np.isnan(found.speed_ratio):
        words += f", its motion by the encoder {found.speed_ratio:.2f} of that by the accelerometer"
    elif check.settings.has_accelerometer:
        words += (
            ", encoder and accelerometer not compared: hold still for two seconds, then tap from a centimetre or more"
        )
    return f"{seen}, played to its end{words}", good and bool(found.bits & TRIAL_FINISHED)


def _tapped(check: Check, begin: int) -> Happened | None:
    """Arm for a trial tap at a gain of 0.1; the event of its end, None if it does not come."""
    check.device.arm(TRIAL_GAIN, trial=True)
    try:
        check.person.asked("tap the surface")
        return check.wait_for(Notice.FINISHED, begin, check.patience_s)
    finally:
        check.device.disarm()


def _as_predicted(check: Check, recorder: Recorder) -> tuple[str, bool]:
    """Compare the trial tap with its prediction, if there is an accelerometer: words and verdict."""
    if check.library is None or not check.described.accelerometer.sensor:
        return "", True
    if not recorder.contacts:
        return ", not recorded whole", False
    tap: PlayedTap = played_tap(
        recorder.contacts[0],
        check.library,
        check.settings,
        TRIAL_GAIN,
        check.described.accelerometer,
    )
    if tap.why:
        return f", not compared: {tap.why}", False
    check.note(trial=tap.compared.scale)
    return f", {tap.compared.scale:.2f} times its prediction", sound(tap.compared.scale)
