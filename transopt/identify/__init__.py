"""From recorded sweeps, taps and heating to the grip-dependent model of a device (seed Sections 3, 4.1, 5).

In the walk from a recording to a library this room stands beside the recordings: it gives the model that a scene may
name in place of masses, springs and dampers of its own (model = "MODEL.json").

How a recording becomes a part of a model file: `measurement` reads a file as a `Measurement`, its signals in SI units
on one time grid. `checks` and `device.trials` look for faults; each is a `Check` of `findings` with its limit and its
text, and a fatal one refuses the record. `condensed` reduces the spectra of all trials, without loss, to what a
likelihood needs; `spectrum` makes a response of it. A model then states what should have been recorded. It is a pole
and a delay (`amplifier`), the chain from motor to arm (`device.chain`, sampled by `device.response`), the same chain
from the surface's force on (`hand.fourth_order`), two thermal nodes (`coil`), or poles alone (`device.black_box`,
`response_fit`). The one search of `squares` finds the unknowns of each; `likelihood` sets up its residuals where
spectra are compared. `device.effects` names what the residuals still contain, and `device.validation` predicts the
records that were held out. The result is a `Fit` (`fit`) or a `DeviceResult` (`device.result`). It has values with
95 % intervals and their covariance, a verdict, and shortfalls, each with what to record again.
"""
