"""The hand from taps on a real surface: mass, damping and stiffness over grip force (seed Sec. 3).

`tap` finds the contact in a record and fits one tap; `lines` fits straight lines over grip through all taps;
`fourth_order` fits the hand of the seed's Fig. 4b, which has a second mass whose motion is not measured.
"""
