"""Twenty hands that nothing was tuned on, each calibrated from three taps: how near their libraries come.

    python -m pytest -m long -n 0 tests/campaigns/test_changing_users.py

`scripts/changing_users.py` writes the page of results with another seed; this asks for its bounds, in the mean over
the entries of the worst hand. The short form is in tests/controller/refine/test_new_hand.py.
"""

import numpy as np
import pytest

from tests.benches.scripts import script

HANDS, SEED = 20, 977


@pytest.mark.long
@pytest.mark.timeout(7200)
def test_calibrated_libraries_come_near_to_who_knows_the_hand() -> None:
    users = script("changing_users")
    found = users.met(HANDS, SEED, users.CONDITIONS["three taps"])
    for truth in users.PAIRS:
        tap, felt = users.behind(found, truth).mean(axis=1).max(axis=0)
        assert tap <= users.MOST_TAP
        assert felt <= users.MOST_FELT
    own = found[0][users.OWN]
    assert set(own) >= {users.NOMINAL, users.MEAN, users.WORST, users.CALIBRATED, users.KNOWN}
    mean = {name: np.mean([one[users.OWN][name] for one in found], axis=(0, 1)) for name in own}
    assert np.all(mean[users.CALIBRATED] < mean[users.NOMINAL])
    assert np.all(mean[users.CALIBRATED] < mean[users.MEAN])
