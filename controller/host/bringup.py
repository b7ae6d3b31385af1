"""The bring-up check: the steps that a device must pass before it may be armed, each with expected and seen values.

No step relies on a person's confirmation: the person is asked to do something, and the device's readings show
whether it was done and with which result. The steps that only look come first; a current flows only after all of
them have passed. Every quantity is checked for being too large, too small, and of the wrong sign.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from controller.host import check_drives, check_looks
from controller.host.check_looks import Verdict
from controller.host.check_state import Check, FailedError
from controller.host.diagnosis import TOLERANCE
from controller.host.driver import DeviceError, LinkLostError
from controller.protocol.capacity import TRIAL_GAIN
from transopt.base.errors import InputError, did_you_mean

WITHIN = f"within {100 * TOLERANCE:g} %"


@dataclass(frozen=True)
class Result:
    """Result of one step. passed : None if the step was left out; `seen` then tells why."""

    name: str
    expected: str
    seen: str
    passed: bool | None


@dataclass(frozen=True)
class Step:
    """One step of the check.

    Attributes
    ----------
    drives : whether a current flows. Such a step needs configuration and library, and that all steps before passed.
    """

    name: str
    run: Callable[[Check], Verdict]
    expected: str
    drives: bool = False


LOOKS = (
    Step(
        "link",
        check_looks.link,
        f"clock within {100 * check_looks.CLOCK_OFF:g} %, known to {1e3 * check_looks.LINK_ERROR_S:g} ms, "
        "nothing lost",
    ),
    Step("emergency-stop", check_looks.emergency_stop, "latches a fault when pressed, resets when released"),
    Step("encoder", check_looks.encoder, f"{1e3 * check_looks.WAY_M:g} mm outwards, {WITHIN}"),
    Step(
        "accelerometer",
        check_looks.accelerometer,
        f"0 ± {check_looks.REST_M_S2:.1f} m/s² at rest, in motion what the encoder says {WITHIN}",
    ),
    Step("grip-zero", check_looks.grip_zero, f"0 ± {check_looks.GRIP_ZERO_N:g} N when released"),
    Step("grip-hold", check_looks.grip_hold, f"{check_looks.GRIP_HELD_N:g} N or more when held; a weight {WITHIN}"),
    Step("current-offset", check_looks.current_offset, f"0 ± {check_looks.OFFSET_A:g} A at rest"),
)
PULSES = Step(
    "polarity",
    check_drives.pulses,
    f"small pulses of either sign: current as asked and acceleration as the model's, {WITHIN}",
    drives=True,
)
STEPS = (
    *LOOKS,
    PULSES,
    Step(
        "trial-tap",
        check_drives.trial_tap,
        f"a tap at gain {TRIAL_GAIN:g} is played to its end, as predicted {WITHIN}",
        drives=True,
    ),
)
SWEEP_STEPS = (
    *LOOKS,
    PULSES,
    Step("trial-sweep", check_drives.trial_sweep, f"a sweep at gain {TRIAL_GAIN:g} is played to its end", True),
)
# Steps that may be left out: a device may lack the part, or the person may have no way to do what is asked.
SKIPPABLE = ("emergency-stop", "encoder", "accelerometer", "grip-zero", "grip-hold")
OF_GRIP = ("grip-zero", "grip-hold")


def check_skipped(names: Sequence[str]) -> tuple[str, ...]:
    """The names of steps to leave out, checked.

    Raises
    ------
    InputError : a step must not be left out, or does not exist.
    """
    for name in names:
        if name not in SKIPPABLE:
            raise InputError(f"--skip {name}: must be one of {', '.join(SKIPPABLE)}{did_you_mean(name, SKIPPABLE)}")
    return tuple(names)


def check_step(name: str) -> str:
    """The name of one step to repeat, checked.

    Raises
    ------
    InputError : there is no step of this name.
    """
    names = list(dict.fromkeys(step.name for step in (*STEPS, *SWEEP_STEPS)))
    if name not in names:
        raise InputError(f"--step {name}: must be one of {', '.join(names)}{did_you_mean(name, names)}")
    return name


def run_steps(
    check: Check,
    skip: tuple[str, ...] = (),
    tell: Callable[[Result], None] | None = None,
    only: str | None = None,
) -> list[Result]:
    """Run all steps in order; `tell` is called with the result of each.

    Parameters
    ----------
    skip : names of steps to leave out, from `SKIPPABLE`.
    only : the one step to run; None for all.

    Raises
    ------
    LinkLostError : the link to the device is lost.
    """
    results: list[Result] = []
    for step in SWEEP_STEPS if check.settings.host_starts else STEPS:
        if only not in (None, step.name):
            continue
        results.append(_result(check, step, skip, results))
        if tell is not None:
            tell(results[-1])
    return results


def _lacking(check: Check, step: Step) -> str | None:
    """Reason why a step does not apply to this device; None if it does."""
    if step.name in OF_GRIP and check.settings.assumed_grip_N is not None:
        return "left out: this device has no grip sensor, or this library needs none"
    if step.name == "accelerometer" and not check.described.accelerometer.sensor:
        return "left out: this device has no accelerometer"
    return None


def _result(check: Check, step: Step, skip: tuple[str, ...], before: list[Result]) -> Result:
    reason = _lacking(check, step)
    if step.name in skip:
        reason = "left out by --skip"
    elif step.drives and any(result.passed is False for result in before):
        reason = "left out: a step before it has failed"
    elif step.drives and not check.loaded:
        reason = "left out: give a library"
    if reason is not None:
        return Result(step.name, step.expected, reason, None)
    try:
        seen, passed = step.run(check)
    except LinkLostError:
        raise
    except (FailedError, DeviceError) as failed:
        seen, passed = str(failed), False
    return Result(step.name, step.expected, seen, passed)


def drop_evidence(check: Check) -> None:
    """Make the device discard its evidence after a step failed that only the host can judge.

    Only the host judges the grip and compares the trial tap with its prediction.
    """
    if check.configuration is not None and check.device.fault is None:
        check.device.configure(check.configuration, anew=True)


def passed(check: Check, results: Sequence[Result], skip: tuple[str, ...] = ()) -> bool:
    """Whether the device may be armed: each step passed, was left out by the user, or does not apply to it."""
    steps = {step.name: step for step in (*STEPS, *SWEEP_STEPS)}
    return all(
        result.passed
        or (result.passed is None and (result.name in skip or _lacking(check, steps[result.name]) is not None))
        for result in results
    )
