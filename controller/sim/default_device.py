"""The default device, for a run without library and scene: an RE 25 on a Phantom-class transmission."""

from controller.servo.default_drive import AMPLIFIER, RE_25
from controller.sim.true_device import Joint, TrueDevice
from transopt.plant.hand import LinearInGrip


def _fixed(value: float) -> LinearInGrip:
    return LinearInGrip(value, 0.0)


DEFAULT_DEVICE = TrueDevice(
    masses_kg=(_fixed(0.014), _fixed(0.026), _fixed(0.010)),
    joints=(
        Joint(_fixed(6e4), _fixed(8.0)),
        Joint(LinearInGrip(3000.0, 2000.0), LinearInGrip(6.0, 3.0)),
        Joint(LinearInGrip(160.0, 110.0), LinearInGrip(6.0, 3.0)),
    ),
    stylus=1,
    skin=1,
    force_per_current_N_A=1.25,
    amplifier=AMPLIFIER,
    coil=RE_25,
)
