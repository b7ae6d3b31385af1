"""Amplifier and motor of the built-in device (a Maxon RE 25), assumed where neither a library nor the device says."""

from transopt.plant.amplifier import Amplifier
from transopt.plant.coil import CoilModel

AMPLIFIER = Amplifier(1050.0, 68e-6, 6.0)
RE_25 = CoilModel(R_ohm=2.18, R_wh_K_W=3.1, R_ha_K_W=14.0, tau_w_s=12.0, tau_h_s=612.0, limit_C=100.0)
