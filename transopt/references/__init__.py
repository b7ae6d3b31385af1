"""References: the motion that the motor has to produce, at the switching instants of a problem.

`reference` scales and averages the taps of one speed and grip; `references` holds those of a scene and blends between
them. `targets` are named motions without a tap, such as a click or a texture.
"""
