"""Recordings that cannot be taps in the units that are stated, and the unit that is to be checked."""

from dataclasses import replace

import numpy as np
import pytest

import problems
from tests.benches.places import IMPACTS
from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2, Signal
from transopt.recordings.plausible import pulse_length_s
from transopt.recordings.recording import Recording
from transopt.recordings.settings import Recordings
from transopt.recordings.tap import prepare, read_recordings
from transopt.references.references import assign
from transopt.scene.recordings import recordings_of

SETTINGS = Recordings(files=["unused"])
KINDS = ["wood_on_foam", "hard_metal", "soft_rubber", "firm_fast"]


def stretched(tap: Recording, *, time: float = 1.0, acceleration: float = 1.0, position: float = 1.0) -> Recording:
    """A tap whose columns are read in units that are off by factors."""
    a, z = tap.acceleration, tap.position
    return replace(
        tap,
        acceleration=Signal(time * a.start_s, time * a.dt_s, acceleration * a.values),
        position=Signal(time * z.start_s, time * z.dt_s, position * z.values),
    )


@pytest.fixture
def tap(taps: list[Recording]) -> Recording:
    """A tap on wood."""
    return taps[0]


@pytest.mark.parametrize("kind", KINDS)
class TestEveryObject:
    """From rubber to metal: the taps pass, and with any column in another unit the right one is blamed."""

    def taps(self, kind: str) -> list[Recording]:
        return recordings_of(problems.load(kind))

    def test_taps_pass(self, kind: str) -> None:
        for tap in self.taps(kind):
            assert not prepare(tap, SETTINGS).implausible
            assert not prepare(stretched(tap, acceleration=-1), SETTINGS).implausible

    @pytest.mark.parametrize(
        ("factors", "words"),
        [
            ({"time": 1e-3}, "check the unit of the time (s called ms?)"),
            ({"time": 1e3}, "check the unit of the time (ms called s?)"),
            ({"acceleration": 1 / STANDARD_GRAVITY_M_S2}, "check the unit of the acceleration (g called m/s^2?)"),
            ({"acceleration": STANDARD_GRAVITY_M_S2}, "check the unit of the acceleration (m/s^2 called g?)"),
        ],
    )
    def test_the_right_unit_is_blamed(self, kind: str, factors: dict[str, float], words: str) -> None:
        for tap in self.taps(kind):
            assert words in prepare(stretched(tap, **factors), SETTINGS).implausible


def test_a_position_or_a_speed_of_another_unit(tap: Recording) -> None:
    fitted = replace(tap, speed_m_s=None)
    for factor in (1e-3, 1e3):
        said = prepare(stretched(fitted, position=factor), SETTINGS).implausible
        assert "check the unit of the position that the speed is fitted to" in said
    assert "check the unit of the speed" in prepare(replace(tap, speed_m_s=10.0), SETTINGS).implausible


def test_what_a_scene_states_itself_is_named(tap: Recording) -> None:
    turned = SETTINGS.model_copy(update={"polarity": "negative"})
    assert 'recordings.polarity = "negative"' in prepare(tap, turned).implausible
    late = SETTINGS.model_copy(update={"onset_s": 0.1})
    assert "recordings.onset_s" in prepare(tap, late).implausible


@pytest.mark.parametrize("onset_s", [-0.1, 0.2, 1e9])
def test_an_onset_outside_of_the_recording_is_refused(tap: Recording, onset_s: float) -> None:
    outside = SETTINGS.model_copy(update={"onset_s": onset_s})
    with pytest.raises(InputError, match=r"recordings.onset_s = .* outside of the recording, 0 to 0.1495 s: .*leave"):
        prepare(tap, outside)
    assert prepare(tap, SETTINGS).onset_s == pytest.approx(0.03, abs=1e-3)


def test_without_a_speed_the_peak_is_looked_at(tap: Recording) -> None:
    tap = replace(tap, speed_m_s=None, position=None)
    assert not prepare(tap, SETTINGS).implausible
    for factor in (0.05, 5000.0):
        said = prepare(stretched_acceleration(tap, factor), SETTINGS).implausible
        assert "check the unit of the acceleration" in said


def stretched_acceleration(tap: Recording, factor: float) -> Recording:
    return replace(tap, acceleration=replace(tap.acceleration, values=factor * tap.acceleration.values))


def test_gravity_without_a_baseline_blames_nobody(tap: Recording) -> None:
    """A recorder that triggers on the pulse leaves nothing to find the offset from."""
    onset = prepare(tap, SETTINGS).onset_s
    first = int(onset / tap.acceleration.dt_s)
    cut = Signal(0.0, tap.acceleration.dt_s, tap.acceleration.values[first:] + STANDARD_GRAVITY_M_S2)
    prepared = prepare(replace(tap, acceleration=cut, position=None), SETTINGS)
    assert "no baseline" in prepared.notes[0]
    assert not prepared.implausible


def test_noise_and_ringing_do_not_shorten_a_pulse() -> None:
    t = np.arange(0, 0.1, 1e-6)
    pulse = np.where((t > 0.03) & (t < 0.038), np.sin(np.pi * (t - 0.03) / 0.008), 0.0)
    plain = pulse_length_s(Signal(0.0, 1e-6, pulse))
    assert plain == pytest.approx(0.008, rel=0.5)
    rough = pulse + 0.1 * np.random.default_rng(0).standard_normal(t.size) + 0.2 * np.sin(2 * np.pi * 2e4 * t) * pulse
    assert pulse_length_s(Signal(0.0, 1e-6, rough)) == pytest.approx(plain, rel=0.5)


def test_the_pulse_of_a_long_recording_is_as_long_as_that_of_a_short_one() -> None:
    pulse = np.sin(np.linspace(0.0, np.pi, 500))
    short, long = np.zeros(5_000), np.zeros(250_000)  # of the long one means of samples are looked at
    short[2_000:2_500] = long[200_000:200_500] = pulse
    plain = pulse_length_s(Signal(0.0, 1e-5, short))
    assert plain == pytest.approx(2 * 5e-3 * 2 / np.pi, rel=0.2)  # half as high as the pulse, and of its area
    assert pulse_length_s(Signal(0.0, 1e-5, long)) == pytest.approx(
        plain, rel=0.2
    )  # lengths are tried in steps of a fifth


def test_the_position_in_the_place_of_the_acceleration() -> None:
    ramp = Signal(0.0, 1e-4, -0.2 * (np.arange(2500) * 1e-4 - 0.06))
    said = prepare(
        Recording(name="tap", source="", sha256="", acceleration=ramp, speed_m_s=0.2), SETTINGS
    ).implausible
    assert "that the acceleration is no other column" in said


def test_refused_unless_accepted(tap: Recording) -> None:
    wrong = stretched(tap, acceleration=0.1)
    with pytest.raises(InputError, match=r"unit of the acceleration.*recordings.implausible = \"accept\""):
        assign([prepare(wrong, SETTINGS)], [0.1], SETTINGS)
    accepted = SETTINGS.model_copy(update={"implausible": "accept"})
    ((taken, _),) = assign([prepare(wrong, accepted)], [0.1], accepted)[0]
    assert taken.implausible


@pytest.mark.skipif(not IMPACTS.is_dir(), reason="the recorded impacts (CC BY-SA) are not part of the project")
def test_recorded_impacts_pass() -> None:
    settings = Recordings(folder=str(IMPACTS), files=["acc_base_a*.txt"], speed_m_s=1.14)
    taps = [prepare(recording, settings) for recording in read_recordings(settings)]
    assert len(taps) == 25
    assert not any(tap.implausible for tap in taps)


def test_a_tap_of_70_g_or_of_10_m_s_is_asked_about(tap: Recording) -> None:
    unknown = replace(tap, speed_m_s=None, position=None)
    high = 70 * STANDARD_GRAVITY_M_S2 / prepare(unknown, SETTINGS).peak_m_s2
    said = prepare(stretched_acceleration(unknown, high), SETTINGS).implausible
    assert "a tap's by hand 0.3 to 60 g" in said
    assert "9.807: g and m/s^2?" in said
    # Speed and acceleration wrong in step agree with each other, and no hand is as fast.
    speed = prepare(tap, SETTINGS).speed_m_s
    both = replace(stretched_acceleration(tap, 10 / speed), speed_m_s=10.0)
    said = prepare(both, SETTINGS).implausible
    assert "the incoming speed is 10 m/s, a hand's 0.01 to 3 m/s: check the unit of the speed" in said
    # Another rig's impacts are scaled, and are no hand's.
    scaled = SETTINGS.model_copy(update={"amplitude_scale": 0.1})
    assert not prepare(both, scaled).implausible


class TestSecondHit:
    def hit_twice(self, tap: Recording, after_s: float, share: float) -> Recording:
        x = tap.acceleration
        onset, size = prepare(tap, SETTINGS).onset_s, prepare(tap, SETTINGS).peak_m_s2
        t = x.times_s - onset - after_s
        pulse = np.where((t > 0) & (t < 3e-3), np.sin(np.pi * t / 3e-3), 0.0)
        return replace(tap, acceleration=replace(x, values=x.values + share * size * pulse))

    @pytest.mark.parametrize(("after_s", "share"), [(0.03, 0.4), (0.05, 0.9), (0.08, 0.3)])
    def test_is_named(self, tap: Recording, after_s: float, share: float) -> None:
        found = prepare(self.hit_twice(tap, after_s, share), SETTINGS)
        (note,) = [each for each in found.notes if each.startswith("a second hit ")]
        assert float(note.split()[3]) == pytest.approx(1e3 * after_s, abs=2)
        assert float(note.split()[7]) == pytest.approx(100 * share, rel=0.3)
        # Cut off as the note says, there is none.
        x = found.recording.acceleration
        kept = x.times_s < found.onset_s + after_s - 1e-3
        cut = replace(found.recording, acceleration=replace(x, values=x.values[kept]), position=None)
        assert not [each for each in prepare(cut, SETTINGS).notes if "second hit" in each]

    @pytest.mark.parametrize("kind", KINDS)
    def test_ringing_and_a_hand_are_none(self, kind: str) -> None:
        random = np.random.default_rng(5)
        for tap in recordings_of(problems.load(kind)):
            x = tap.acceleration
            rough = x.values + 0.01 * x.values.max() * random.standard_normal(x.values.size)
            push = 0.3 * x.values.max() * np.clip((x.times_s - x.times_s[-1] + 0.05) / 0.05, 0, 1)
            for values in (x.values, rough, rough + push):
                found = prepare(replace(tap, acceleration=replace(x, values=values)), SETTINGS)
                assert not [each for each in found.notes if "second hit" in each]
