"""The findings that checks of recorded files can make, and their messages."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum, StrEnum

from transopt.base.errors import InputError

LEAST_CYCLES = 1.0  # cycles per octave, all trials together
LEAST_TRIALS = 2
JITTER_NOTED, JITTER_LIMIT = 0.01, 0.2  # rms deviation from the uniform grid, in steps
END_SAMPLES, END_PART = 3, 0.1  # number of last samples; their largest size as a share of the peak
LEAST_RATE_HZ = 900.0  # of records of a device: no servo is slower than 1 kHz
COHERENT = 0.8  # least coherence of a bin that counts
FATAL, NOTED = True, False  # whether a finding refuses the records
# Messages of checks that are noted or fatal by the size of what they find.
_JITTER = (
    "time stamps {steps:.2g} steps (rms) off the uniform grid, resampled to it: phases are off by {phase_deg:.2g} "
    "deg at 1 kHz, delays by {late_us:.2g} us"
)
_CYCLES = (
    "{cycles:.2g} cycles per octave below {up_to_Hz:.3g} Hz in {trials} trials, must be at least {limit:g}; "
    "{longer}add trials from {low_Hz:.3g} Hz on"
)


class Fault(StrEnum):
    """The kinds of faults that records can have."""

    TOO_FEW_CYCLES = "too few cycles"
    CLIPPED = "clipped sensor"
    SATURATED = "saturated command"
    NO_EXCITATION = "no excitation"
    CUT_SHORT = "not at rest at both ends"
    JITTER = "jittered sampling"
    MISSING = "samples missing"
    RATES = "rates that differ"
    POLARITY = "wrong polarity"
    UNITS = "units off by 9.81"
    CURRENT_SCALE = "current off scale"
    POSITION_SCALE = "position off scale"
    SLOW = "sampled too slowly"
    SHIFTED = "samples shifted"
    BANDWIDTH = "bandwidth not stated"
    MISSING_GRIP = "missing grip"
    INCOHERENT = "coherence low"
    BESIDE = "beside the model"


@dataclass(frozen=True)
class Finding:
    """One fault of a record: what is wrong, where, and what to record again.

    Attributes
    ----------
    fault : kind of fault.
    where : file, grip or band.
    text : value, limit and remedy.
    fatal : whether the records must not be fitted.
    cause : name in the model file of an effect found beside the model; empty if the file does not state it.
    """

    fault: Fault
    where: str
    text: str
    fatal: bool
    cause: str = ""

    def __str__(self) -> str:
        return f"{self.where}: {self.fault}: {self.text}"


class Check(Enum):
    """Every check of records: the fault that it finds, whether that is fatal, its limit and its message.

    The message states the measured value, the limit and the remedy.
    """

    # fmt: off
    JITTER_NOTED = Fault.JITTER, NOTED, JITTER_NOTED, _JITTER
    JITTERED = Fault.JITTER, FATAL, JITTER_LIMIT, (
        _JITTER + "; must be at most {limit:g}; sample by the servo's timer and record again")
    MISSING = Fault.MISSING, NOTED, None, "{missing}"
    STILL = Fault.NO_EXCITATION, FATAL, None, "{quantity} stays at {value:g} {unit}; check {what} and record again"
    SATURATED = Fault.SATURATED, FATAL, None, (
        "{count} samples at the {side} value {value:.4g} {unit}, first at {first_s:.4g} s; lower amplitude or "
        "offset and record again")
    CLIPPED = Fault.CLIPPED, FATAL, None, (
        "{quantity}: {count} samples at the {side} value {value:.4g} {unit}, first at {first_s:.4g} s; lower the "
        "amplitude, or take a sensor of wider range, and record again")
    CUT_SHORT = Fault.CUT_SHORT, NOTED, END_PART, (
        "{quantity} ends {last:.3g} {unit} off its rest, {part:.0%} of its peak, should be below {limit:.0%}; record "
        "until everything rests")
    BEGUN_LATE = Fault.CUT_SHORT, NOTED, END_PART, (
        "{quantity} begins {first:.3g} {unit} off its rest, {part:.0%} of its peak, should be below {limit:.0%}: "
        "what came before is not known, so that nothing is judged by this record; begin it before the command does")
    RATES = Fault.RATES, FATAL, None, (
        "{rate_Hz:.6g} Hz, {first} {wanted_Hz:.6g} Hz: must be one rate; record all trials at the servo's")
    SLOW = Fault.SLOW, FATAL, LEAST_RATE_HZ, (
        "{rate_Hz:.4g} Hz, must be {limit:g} Hz or more; record at the servo's rate, or name the times time_ms if "
        "they are in ms")
    FEW_CYCLES = Fault.TOO_FEW_CYCLES, NOTED, LEAST_CYCLES, _CYCLES
    HARDLY_ANY_CYCLES = Fault.TOO_FEW_CYCLES, FATAL, LEAST_CYCLES, _CYCLES
    FEW_BINS = Fault.TOO_FEW_CYCLES, FATAL, None, (
        "resolves {bins} bands of frequency, at least {least} are needed; sweep longer and wider")
    INCOHERENT = Fault.INCOHERENT, NOTED, COHERENT, (
        "{coherence:.2f} at {first_Hz:.3g} to {last_Hz:.3g} Hz, must be {limit:g}; record again there with "
        "more current")
    CURRENT_ALONE = Fault.INCOHERENT, FATAL, None, (
        "the current does not follow the command: {share}; check the current monitor and record again")
    CURRENT_UNLIKE = Fault.INCOHERENT, FATAL, None, (
        "the measured current does not follow the command; check the current monitor, and record again")
    COMMAND_TURNED = Fault.POLARITY, FATAL, None, (
        "from command to current: phase {phase_deg:.0f} deg at {at_Hz:.3g} Hz, must be near 0; swap the leads of "
        "the current sensor or correct its sign, and record again")
    CURRENT_TURNED = Fault.POLARITY, FATAL, None, (
        "current_A is opposite to command_A; turn the sign of the one that is not positive when pushing out")
    NOT_PASSIVE = Fault.POLARITY, FATAL, None, (
        "the phase from current to acceleration at {low_Hz:g} to {high_Hz:g} Hz is that of a passive device turned "
        "by 180 deg; turn the accelerometer or swap the motor's leads (positive current pushes out), and record "
        "again")
    ANSWERS_TURNED = Fault.POLARITY, FATAL, None, (
        "acceleration answers the current the other way than in {others}; turn the accelerometer or the current's "
        "sign in this file, or record it again")
    POSITION_TURNED = Fault.POLARITY, FATAL, None, (
        "position_m goes the other way than the acceleration makes it; turn its sign, so that it grows out of the "
        "object")
    POSITION_SCALE = Fault.POSITION_SCALE, FATAL, None, (
        "position_m is {ratio:.3g} times the path that the acceleration makes; name it position_mm if it is in mm, "
        "or correct the encoder's count_m, and record again")
    UNIT = Fault.UNITS, FATAL, None, (
        "acceleration is {ratio:.3g} times that of {against}, {which}; is the column in {unit} but named {column}? "
        "Correct its name")
    GAIN_APART = Fault.CURRENT_SCALE, FATAL, None, (
        "the gain from command to current is {ratio:.3g} times that of the other files; check the current monitor "
        "and record again")
    CURRENT_SCALE = Fault.CURRENT_SCALE, FATAL, None, (
        "current_A is {gain:.3g} times what the amplifier makes of command_A; are both in A?")
    DELAY_APART = Fault.SHIFTED, FATAL, None, (
        "the current comes {samples:+.2f} samples later than in the other files; read both at the same tick and "
        "record again")
    CURRENT_SHIFTED = Fault.SHIFTED, NOTED, None, (
        "current_A comes {samples} samples {way} than the known amplifier makes it of command_A; read command, "
        "current and acceleration at the same tick, or identify this amplifier into --out first")
    DELAYED = Fault.SHIFTED, NOTED, None, (
        "comes {late_ms:.4g} ms ({samples} samples) later than any device answers: taken out of all files as a pure"
        " delay of its channel; about a sample of it may be left in the masses: record current and acceleration on "
        "one clock")
    BANDWIDTH = Fault.BANDWIDTH, NOTED, None, (
        "taken as ideal, so that its delay goes into the masses; add # accelerometer_Hz: 2500, or what it has")
    NO_GRIP = Fault.MISSING_GRIP, FATAL, None, "no grip stated; add # grip_N: 3 (0 if nobody holds it)"
    FEW_TRIALS = Fault.MISSING_GRIP, NOTED, LEAST_TRIALS, (
        "{trials} trial, at least {limit:g} are needed; record another one of the other polarity")
    ONE_POLARITY = Fault.MISSING_GRIP, NOTED, None, (
        "all trials have one polarity, so that distortion of even order stays; record reversed ones too")
    GRIP_OUTSIDE = Fault.MISSING_GRIP, NOTED, None, (
        "grip {grip_N:.3g} N, sweeps at {recorded} N: not judged; record sweeps there")
    # fmt: on

    def __init__(self, fault: Fault, fatal: bool, limit: float | None, text: str) -> None:
        self.fault, self.fatal, self.limit, self.text = fault, fatal, limit, text

    def at(self, where: str, **measured: object) -> Finding:
        """The finding of this check in a file, at a grip or in a band, with the measured values filled in."""
        return Finding(self.fault, where, self.text.format(limit=self.limit, **measured), self.fatal)


def beside(where: str, text: str, cause: str = "") -> Finding:
    """The finding of an effect beside the model; `cause` is its name in the model file, empty if it has none."""
    return Finding(Fault.BESIDE, where, text, NOTED, cause)


def refuse(findings: Iterable[Finding]) -> list[Finding]:
    """The findings that are not fatal.

    Raises
    ------
    InputError : a finding is fatal; the message is the first fatal one and tells how many more there are.
    """
    listed = list(findings)
    fatal = [finding for finding in listed if finding.fatal]
    if fatal:
        more = f" (and {len(fatal) - 1} more such findings)" if len(fatal) > 1 else ""
        raise InputError(f"{fatal[0]}{more}")
    return listed
