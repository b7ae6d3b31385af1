"""The device from sweeps of current and acceleration at several grips.

`trials` sorts the records by grip and estimates the responses; `chain_fit` and `black_box` fit a drive chain and a
state space to them; `validation` compares both with transients that were kept out of the fit, and says what a model
is good for; `findings` says what the records have beside it; `identify` does all of it and chooses the better model.
"""
