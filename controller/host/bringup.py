"""The bring-up check: what must hold of a device before it may be armed, step by step, expected beside seen.

Nobody is asked to confirm anything: the person is asked to do things, and the device's own readings show that it was
done and what came of it. The steps that only look come first; a current flows only once all of those have passed.
Every size is checked upwards and downwards, in sign too.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from controller.host import check_drives, check_looks
from controller.host.check_looks import Verdict
from controller.host.check_state import Check, FailedError
from controller.host.diagnosis import TOLERANCE
from controller.host.driver import DeviceError, LinkLostError
from controller.protocol.capacity import TRIAL_GAIN
from transopt.base.errors import InputError
from transopt.base.nearest import did_you_mean

WITHIN = f"within {100 * TOLERANCE:g} %"


@dataclass(frozen=True)
class Result:
    """One step. passed : None if it was left out, for the reason that stands in `seen`."""

    name: str
    expected: str
    seen: str
    passed: bool | None


@dataclass(frozen=True)
class Step:
    """One step.

    Attributes
    ----------
    drives : a current flows, so that everything before it has to have passed; needs configuration and library.
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
# What a device may lack, or what the person at it may have no way to do.
SKIPPABLE = ("emergency-stop", "encoder", "accelerometer", "grip-zero", "grip-hold")
OF_GRIP = ("grip-zero", "grip-hold")


def check_skipped(names: Sequence[str]) -> tuple[str, ...]:
    """The names, if all of them may be left out.

    Raises
    ------
    InputError : one may not.
    """
    for name in names:
        if name not in SKIPPABLE:
            raise InputError(f"--skip {name}: must be one of {', '.join(SKIPPABLE)}{did_you_mean(name, SKIPPABLE)}")
    return tuple(names)


def check_step(name: str) -> str:
    """The name of one step to repeat, if there is such a step.

    Raises
    ------
    InputError : there is none.
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
    """All steps in order; `tell` is called with each as it is done.

    Parameters
    ----------
    skip : names of steps to leave out, of SKIPPABLE.
    only : the one step to be done; None for all.

    Raises
    ------
    LinkLostError : the device is gone.
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
    """Why a step means nothing on this device."""
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
    """Let the device forget what it has seen, after a step that the host alone found to have failed.

    The grip, and whether the trial tap was the predicted one, only the host can judge.
    """
    if check.configuration is not None and check.device.fault is None:
        check.device.configure(check.configuration, anew=True)


def passed(check: Check, results: Sequence[Result], skip: tuple[str, ...] = ()) -> bool:
    """Whether the device may be armed: no step failed, and each was done or left out by the user or for its kind."""
    steps = {step.name: step for step in (*STEPS, *SWEEP_STEPS)}
    return all(
        result.passed
        or (result.passed is None and (result.name in skip or _lacking(check, steps[result.name]) is not None))
        for result in results
    )
