"""The prediction of a tap by a library, at its nodes and between them."""

from dataclasses import dataclass, replace

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.library.library import Library
from transopt.library.place import interpolation_weights
from transopt.plant.discretise import discretise
from transopt.plant.intention import INTENTION_S
from transopt.plant.wall import HandOver
from transopt.proof.replay import replay


@dataclass(frozen=True)
class Prediction:
    """A tap as the library predicts it.

    Attributes
    ----------
    speed_m_s, grip_N : as played: on the grid's edge for a tap outside it.
    silent : whether nothing is played, for lack of grip or speed.
    times_s : (N,) tau_k, from contact. acceleration_m_s2 : (N,) y'' there, the contribution of the command.
    reference_m_s2, own_m_s2 : (N,) the target r - a_free, and a_free. current_A : (N,).
    after_times_s, after_m_s2, reference_after_m_s2, own_after_m_s2 : (M,) instants after the waveform, y'', the
        target and a_free there.
    floor, repeatability : blended like the waveforms; NaN where the recordings have no repeats.
    gain : factor on the transient.
    """

    speed_m_s: float
    grip_N: float
    silent: bool
    times_s: FloatArray
    acceleration_m_s2: FloatArray
    reference_m_s2: FloatArray
    own_m_s2: FloatArray
    current_A: FloatArray
    after_times_s: FloatArray
    after_m_s2: FloatArray
    reference_after_m_s2: FloatArray
    own_after_m_s2: FloatArray
    floor: float
    repeatability: float
    gain: float = 1.0

    @property
    def whole_m_s2(self) -> FloatArray:
        """(N,) predicted acceleration of the stylus: y'' by the current plus a_free without it."""
        return self.acceleration_m_s2 + self.own_m_s2

    @property
    def recorded_rms_m_s2(self) -> float:
        """Rms of the recorded tap at full gain until the hand can react."""
        return float(np.sqrt(np.mean((self.reference_m_s2 + self.own_m_s2)[self.times_s <= INTENTION_S] ** 2)))

    @property
    def recorded_m_s2(self) -> FloatArray:
        """(N,) acceleration of the recorded tap at this gain."""
        return self.gain * self.reference_m_s2 + self.own_m_s2


def predict(
    library: Library, speed_m_s: float, grip_N: float, gain: float = 1.0, scale: float = 1.0, cooled: float = 0.0
) -> Prediction:
    """Prediction for any speed and grip.

    At a node it is the library's own; elsewhere the blended command is replayed through the model of that grip,
    built from the scene that the library carries.

    Parameters
    ----------
    gain : multiplies the transient and a wall's feedback.
    scale, cooled : for a hot coil, at which the servo plays `scale` times a blend with a share `cooled`, 0 to 1, of
        the cool command.

    Raises
    ------
    InputError : speed or grip is not finite, or `cooled` > 0 for a library without cool commands.
    """
    if cooled > 0.0 and library.cool is None:
        raise InputError(f"cooled = {cooled:g}: this library has no cool commands: solve it with grid.cool_share")
    wave = library.at(speed_m_s, grip_N)
    v, F = wave.speed_m_s, wave.grip_N
    wanted = library.wanted(v, F)
    target = wanted.target
    grid, scene = library.time_grid(), library.scene()
    whole = gain == 1.0 and scale == 1.0 and cooled == 0.0
    at_node = v in library.speeds_m_s and F in library.grips_N and whole and not wave.silent
    if at_node:
        iv, ig = (int(np.searchsorted(nodes, x)) for nodes, x in ((library.speeds_m_s, v), (library.grips_N, F)))
        acceleration, current = library.acceleration_m_s2[iv, ig], library.plant_input[iv, ig]
        after = library.lasting(iv, ig)[0][grid.stages :]
    else:
        wall, walls = library.wall(), None
        command = wave.transient_command
        if library.cool is not None and cooled > 0.0:
            command = (1.0 - cooled) * command + cooled * library.cool.at(v, F).transient_command
        command = gain * scale * command
        if wall is not None:
            nominal = wanted.nominal_position_at_ticks_m
            softer = replace(wall, stiffness_N_m=gain * wall.stiffness_N_m, damping_N_s_m=gain * wall.damping_N_s_m)
            walls = [HandOver(softer, nominal, v, nominal < 0)]
        stage = discretise(scene.plant(F), library.amplifier(), grid.dt_s, position=wall is not None)
        [played] = replay(stage, grid, command[None], [target], None, walls=walls)
        acceleration, current, after = played.acceleration_m_s2, played.plant_input, played.after_m_s2
    by_v, by_F = interpolation_weights(library.speeds_m_s, v), interpolation_weights(library.grips_N, F)
    repeats = np.array(library.meta["repeatability"], dtype=float)
    shares = np.outer(by_v, by_F)
    used = shares > 0
    return Prediction(
        speed_m_s=v,
        grip_N=F,
        silent=wave.silent,
        times_s=grid.switching_times_s,
        acceleration_m_s2=acceleration,
        reference_m_s2=target.window_m_s2,
        own_m_s2=target.free_window_m_s2,
        current_A=current,
        after_times_s=grid.after_times_s,
        after_m_s2=after,
        reference_after_m_s2=target.after_m_s2,
        own_after_m_s2=target.free_after_m_s2,
        floor=float(by_v @ library.floor @ by_F),
        repeatability=float(repeats[used] @ shares[used]),
        gain=gain,
    )
