"""The kinds of plant; a scene selects one by `model.kind`."""

from transopt.plant.arm import Arm
from transopt.plant.drive import Drive
from transopt.plant.fourth_order import FourthOrder
from transopt.plant.matrices import Matrices
from transopt.plant.moving_coil import Inertial, VoiceCoil
from transopt.plant.second_order import SecondOrder

Model = SecondOrder | FourthOrder | Drive | Arm | Inertial | VoiceCoil | Matrices
