"""The kinds of plant that a scene may name; `model.kind` says which."""

from transopt.plant.drive import Drive
from transopt.plant.fourth_order import FourthOrder
from transopt.plant.second_order import SecondOrder

Model = SecondOrder | FourthOrder | Drive
