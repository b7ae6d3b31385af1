"""The scene's table `[recordings]`: where taps come from and how they become references."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from transopt.base.section import Finite, NonNegative, Positive, Section, Speed, Words
from transopt.base.sizes import MOST_COLUMNS, MOST_FILES
from transopt.files.names import Layout


class SimulatedTaps(Section):
    """A real object that the undriven device strikes: the built-in recordings.

    They are made at every grip of the scene, or at `grip_N` alone.
    Contact force on the stylus: k delta^n (1 + c d delta/dt) >= 0, delta the indentation.

    Attributes
    ----------
    grip_N : the one grip of the recordings; without it every grip of the scene is recorded.
    object_mass_kg : mass of the object that is struck.
    object_stiffness_N_m : spring below the object.
    object_damping_N_s_m : damper below the object.
    contact_stiffness_N_m : k of the contact force k delta^n (1 + c d delta/dt).
    contact_exponent : n of that force.
    contact_damping_s_m : c of that force.
    repeats : taps at each speed and grip.
    speed_spread : share by which the speeds of the taps scatter.
    noise_g_rtHz : noise of the accelerometer.
    range_g : range of the accelerometer, beyond which it clips.
    rate_Hz : sample rate of the recordings.
    seed : seed of the random numbers: the same seed makes the same recordings.
    """

    grip_N: Positive | None = None
    object_mass_kg: Positive
    object_stiffness_N_m: NonNegative
    object_damping_N_s_m: NonNegative
    contact_stiffness_N_m: Positive
    contact_exponent: Annotated[float, Field(gt=0, le=10)]
    contact_damping_s_m: NonNegative
    repeats: Annotated[int, Field(ge=1, le=100)] = 3
    speed_spread: Annotated[float, Field(ge=0, lt=0.15)] = 0.05
    noise_g_rtHz: NonNegative = 320e-6
    range_g: Positive = 18.0
    rate_Hz: Annotated[float, Field(ge=1e3, le=1e6)] = 10e3
    seed: Annotated[int, Field(ge=0, le=2**63)] = 1


class Recordings(Section):
    """Settings that say where the taps come from and how they become references.
    `trusted_from_Hz` is the cut-off of an accelerometer that reads no constant, 0.5 to 5 Hz for one of the IEPE type.

    Attributes
    ----------
    files : names or patterns of the recordings, counted from the folder.
    folder : where the files lie, counted from the scene.
    columns : names of the columns in their order, `-` for one to skip.
    units : unit of a column or quantity, before what the file says.
    full_scale_m_s2 : acceleration of full scale in a WAV file.
    channel : channel of a WAV file that is the accelerometer, from 1.
    rate_Hz : sample rate of files that state no times.
    axis : which signal is taken of three axes: the strongest direction, one axis, or DFT321; `all` has what lies
        across the strongest direction as well, for an arm with several motors.
    taps_by_file : which taps of a file with several are used.
    speed_m_s : incoming speed of all files that state none.
    speed_by_file_m_s : incoming speed by file or tap.
    grip_N : grip of all files that state none.
    source : where the recordings come from, in words.
    polarity : sign of the acceleration that slows the stylus down.
    offset_m_s2 : reading at rest that is taken off; `baseline` is the mean before contact.
    onset_s : time of contact in the file; `auto` finds it.
    lowpass_Hz : corner of the low-pass that a recording goes through, with zero phase.
    trusted_from_Hz : cut-off of an accelerometer that reads no constant, such as IEPE; 0 for others.
    speed_tolerance : a tap is scaled to a grid speed that is within this share of its own.
    time_scale : factor on the times, for impacts of another rig.
    amplitude_scale : factor on the acceleration, or scaled such that the change of speed fits.
    implausible : whether recordings that can be no taps are refused.
    simulated : table of an object that the device strikes in place of files.
    """

    files: Annotated[list[str], Field(max_length=MOST_FILES)] = Field(default_factory=list)
    folder: str = "."
    columns: Annotated[list[Words], Field(max_length=MOST_COLUMNS)] = Field(default_factory=list)
    units: Annotated[dict[str, Words], Field(max_length=MOST_COLUMNS)] = Field(default_factory=dict)
    full_scale_m_s2: Positive | None = None
    channel: Annotated[int, Field(ge=1, le=MOST_COLUMNS)] | None = None
    rate_Hz: Annotated[float, Field(ge=20, le=1e9)] | None = None
    axis: Literal["main", "x", "y", "z", "dft321", "all"] | None = None
    taps_by_file: Annotated[dict[str, list[Annotated[int, Field(ge=1)]]], Field(max_length=MOST_FILES)] = Field(
        default_factory=dict
    )
    speed_m_s: Speed | None = None
    speed_by_file_m_s: dict[str, Speed] = Field(default_factory=dict)
    grip_N: NonNegative | None = None
    source: Words = ""
    polarity: Literal["auto", "positive", "negative"] = "auto"
    offset_m_s2: Finite | Literal["baseline"] = "baseline"
    onset_s: Finite | Literal["auto"] = "auto"
    lowpass_Hz: Annotated[float, Field(ge=50, le=1e6)] = 1000.0
    trusted_from_Hz: Annotated[float, Field(ge=0, le=20)] = 0.0  # 0: the sensor reads a constant acceleration
    speed_tolerance: Annotated[float, Field(ge=0, lt=1)] = 0.15
    time_scale: Annotated[float, Field(ge=1e-3, le=1e3)] = 1.0
    amplitude_scale: Annotated[float, Field(ge=1e-6, le=1e6)] | Literal["to_grid_speed"] = 1.0
    implausible: Literal["refuse", "accept"] = "refuse"  # see `transopt.recordings.plausible`
    simulated: SimulatedTaps | None = None

    def layout(self) -> Layout:
        """How the files are to be read."""
        return Layout(self.columns, self.units, self.full_scale_m_s2, self.channel, self.rate_Hz, self.axis or "")

    @model_validator(mode="after")
    def _one_origin(self) -> Self:
        if self.files and self.simulated is not None:
            raise ValueError("give either files or a simulated table, not both")
        return self
