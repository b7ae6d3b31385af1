"""From recorded sweeps, taps and heating to the grip-dependent model of a device (seed Sections 3, 4.1, 5).

In the walk from a recording to a library this room stands beside the recordings: it gives the model that a scene may
name in place of masses, springs and dampers of its own (model = "MODEL.json"). One record through the code:

    measurement -> checks -> spectrum -> amplifier | device | hand | coil -> validation -> model file

Each arrow is a function that takes and returns values. All unknowns are found by the one search of `squares`, those
of a spectrum by the `likelihood` on it; `fit` says what every part of the model file states of its numbers, and its
verdict; `black_box` is for devices that are no drive chain. `transopt.report` draws what each of the four has found.
"""
