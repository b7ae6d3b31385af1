"""The kinds of plant; a scene selects one by `model.kind`."""

from transopt.plant.arm import Arm
from transopt.plant.drive import Drive
from transopt.plant.fourth_order import FourthOrder
from transopt.plant.inertial import Inertial
from transopt.plant.matrices import Matrices
from transopt.plant.second_order import SecondOrder
from transopt.plant.voice_coil import VoiceCoil

Model = SecondOrder | FourthOrder | Drive | Arm | Inertial | VoiceCoil | Matrices
