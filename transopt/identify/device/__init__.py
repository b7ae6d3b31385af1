"""The device from sweeps of current and acceleration at several grips.

`trials` sorts the records by grip and estimates the responses; `chain_fit` and `black_box` fit a drive chain and a
state space to them; `validation` compares both with held-out transients and states what a model is good for;
`findings` names effects in the records that the model lacks; `identify` runs all of it and chooses the better model.
"""
