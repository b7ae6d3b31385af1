"""From recorded sweeps, taps and heating to the grip-dependent model (seed Sections 3, 4.1, 5).

One record through the code:

    measurement -> checks -> spectrum -> amplifier | device | hand | coil -> validation -> model_file

Each arrow is a function that takes and returns values. A scene names the result: model = "MODEL.json".
"""
