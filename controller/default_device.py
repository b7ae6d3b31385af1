"""The default device of DESIGN 3.1, for a run without library and scene: an RE 25 on a Phantom-class transmission."""

from controller.truth import Device, Joint
from transopt.amplifier import Amplifier
from transopt.models import LinearInGrip
from transopt.thermal import CoilModel


def _fixed(value: float) -> LinearInGrip:
    return LinearInGrip(value, 0.0)


RE_25 = CoilModel(R_ohm=2.18, R_wh_K_W=3.1, R_ha_K_W=14.0, tau_w_s=12.0, tau_h_s=612.0, limit_C=100.0)
DEFAULT_DEVICE = Device(
    masses_kg=(_fixed(0.014), _fixed(0.026), _fixed(0.010)),
    joints=(
        Joint(_fixed(6e4), _fixed(8.0)),
        Joint(LinearInGrip(3000.0, 2000.0), LinearInGrip(6.0, 3.0)),
        Joint(LinearInGrip(160.0, 110.0), LinearInGrip(6.0, 3.0)),
    ),
    stylus=1,
    skin=1,
    force_per_current_N_A=1.25,
    amplifier=Amplifier(1050.0, 68e-6, 6.0),
    coil=RE_25,
)
