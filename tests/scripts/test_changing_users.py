"""Libraries in the hands of other users: how near three taps come to who knows the hand.

    python -m pytest -m long -n 0 tests/scripts/test_changing_users.py

The long form asks for the bounds of the script in twenty hands that nothing was tuned on, with another seed than the
page of results has.
"""

import numpy as np
import pytest

import transopt as to
from tests.benches.scripts import script
from transopt.library.library import Library
from transopt.scene.builtin import POPULATION
from transopt.scene.keys import with_values
from transopt.scene.population import load_population
from transopt.scene.scene import Scene

users = script("changing_users")
HANDS, SEED = 20, 977


def test_one_hand_at_one_speed(scene: Scene, library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    slow = with_values(scene, {"grid.speeds_m_s": [0.2]})
    known = slow, load_population(POPULATION), {users.NOMINAL: to.solve(slow, to.recordings_of(slow))}
    monkeypatch.setattr(users, "designed", lambda: known)
    found = users.met(1, SEED, users.CONDITIONS["three taps"])
    for truth in users.PAIRS:
        tap, felt = users.behind(found, truth)[0].max(axis=0)
        assert (tap < users.MOST_TAP, felt < users.MOST_FELT) == (True, True)
    own = {name: errors.mean(axis=0) for name, errors in found[0][users.OWN].items()}
    assert np.all(own[users.CALIBRATED] < own[users.NOMINAL])
    assert [row.split("|")[1].strip() for row in users.worth(found, users.OWN)[2:] if row] == list(own)
    assert users.users_figure([{users.OWN: {**found[0][users.OWN], users.MEAN: found[0][users.OWN][users.NOMINAL]}}])


def test_a_drive_that_is_off_keeps_the_hand(scene: Scene) -> None:
    own = users.true_device(scene, users.Condition(), 1)
    off = users.true_device(scene, users.CONDITIONS["drive off by up to 3 %"], 1)
    assert off.masses_kg[2] == own.masses_kg[2]
    assert off.joints[1:] == own.joints[1:]
    assert off.masses_kg[0] != own.masses_kg[0]
    assert off.joints[0] != own.joints[0]


@pytest.mark.long
@pytest.mark.timeout(7200)
def test_twenty_hands() -> None:
    found = users.met(HANDS, SEED, users.CONDITIONS["three taps"])
    for truth in users.PAIRS:
        tap, felt = users.behind(found, truth).mean(axis=1).max(axis=0)
        assert tap <= users.MOST_TAP
        assert felt <= users.MOST_FELT
    names = (users.NOMINAL, users.MEAN, users.WORST, users.CALIBRATED, users.KNOWN)
    nominal, mean, _, calibrated, _ = (
        np.mean([one[users.OWN][name] for one in found], axis=(0, 1)) for name in names
    )
    assert np.all(calibrated < nominal)
    assert np.all(calibrated < mean)
