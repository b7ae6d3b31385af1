"""From recorded sweeps, taps and heating to the grip-dependent model of a device (seed Sections 3, 4.1, 5).

In the walk from a recording to a library this room stands beside the recordings: it gives the model that a scene may
name in place of masses, springs and dampers of its own (model = "MODEL.json"). One record through the code:

    measurement -> checks -> spectrum -> amplifier | device | hand | coil -> validation -> model file

Each arrow is a function that takes and returns values. The one search of `squares` finds all unknowns; `likelihood`
builds on it for those that are fitted to a spectrum. `fit` states intervals, covariance and verdict of each part of
the model file; `device.black_box` fits devices that are no drive chain. `transopt.report` draws the results.
"""
