"""`transopt plant sweep`: records of a simulation of its own make, and the plant that one command makes of them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.benches.commands import Run, assert_refused

G = 9.80665


@dataclass(frozen=True)
class Actuator:
    """Mass, case and coil by Newton's and Ohm's law, each against the room; no inductance."""

    resonance_Hz: float = 150.0
    quality: float = 8.0  # driven: with the coil's own damping
    mass_kg: float = 0.003
    case_kg: float = 0.1
    BL: float = 0.5
    R_ohm: float = 8.0

    @property
    def gain(self) -> float:
        """Acceleration of the case far above the resonance [m/s^2 per V]."""
        return self.BL / self.R_ohm / self.case_kg

    def acceleration(self, volts: np.ndarray, dt_s: float) -> np.ndarray:
        """(n,) of the case for volts (n, 3) at the start, the middle and the end of every step, by Runge-Kutta."""
        m, M, BL, R = self.mass_kg, self.case_kg, self.BL, self.R_ohm
        mu, w = m * M / (m + M), 2 * np.pi * self.resonance_Hz
        k, c = mu * w**2, mu * w / self.quality - BL**2 / R
        assert c > 0

        def rates(u: np.ndarray, s: np.ndarray) -> np.ndarray:
            x, v, y, z = s  # mass and case; a positive current pushes the case forwards and the mass backwards
            force = BL * (u - BL * (z - v)) / R - k * (y - x) - c * (z - v)
            return np.array([v, -force / m, z, force / M])

        def step(u: np.ndarray, s: np.ndarray) -> np.ndarray:
            one = rates(u[0], s)
            two = rates(u[1], s + dt_s / 2 * one)
            three = rates(u[1], s + dt_s / 2 * two)
            return s + dt_s / 6 * (one + 2 * two + 2 * three + rates(u[2], s + dt_s * three))

        # The step is linear: by the state, and by the three voltages.
        by_state, by_volts = step(np.zeros((3, 4)), np.eye(4)), step(np.eye(3), np.zeros((4, 3)))
        states, s = [], np.zeros(4)
        for pushed in volts @ by_volts.T:
            states.append(s)
            s = by_state @ s + pushed
        return np.asarray(rates(volts[:, 0], np.transpose(states))[3])


def record(
    file: str,
    seed: int,
    *,
    seconds: float = 2.0,
    noise: float = 0.01,
    rate_Hz: float = 5e3,
    late: int = 0,
    **other: float,
) -> Actuator:
    """A logarithmic sweep of 20 to 1000 Hz with noise, an offset and gravity, in volts and g, `late` samples late."""
    actuator, random = Actuator(), np.random.default_rng(seed)
    t = np.arange(round(seconds * rate_Hz)) / rate_Hz
    octaves, played_s = np.log(1000 / 20), 0.95 * seconds

    def volts(at_s: np.ndarray) -> np.ndarray:
        phase = 2 * np.pi * 20 * played_s / octaves * np.expm1(octaves * at_s / played_s)
        return np.where(at_s < played_s, 2.0 * np.sin(phase), 0.0)

    u = volts(t[:, None] + np.array([0.0, 0.5, 1.0]) / rate_Hz)
    a = np.roll(actuator.acceleration(u, 1 / rate_Hz) / G, late)
    a = a + 1.0 + noise * np.abs(a).max() * random.standard_normal(t.size)
    measured = u[:, 0] + 0.003 + 2e-3 * random.standard_normal(t.size)
    names = f"time_s,voltage_V,{other.get('named', 'acceleration_g')}"
    np.savetxt(file, np.transpose([t, measured, a * other.get("times", 1.0)]), "%.7g", ",", header=names, comments="")
    return actuator


def seen(file: str) -> tuple[float, float, float]:
    """Resonance [Hz], quality and gain [m/s^2 per V] of the plant in a file."""
    plant = np.load(file)
    (pole,) = [each for each in np.linalg.eigvals(plant["A"]) if each.imag > 0]
    return abs(pole) / (2 * np.pi), abs(pole) / (-2 * pole.real), float(np.squeeze(plant["D"]))


@pytest.mark.parametrize("seed", [101, 102, 103])
def test_two_seconds_of_time_volts_and_g_are_a_plant_within_one_percent(run: Run, seed: int) -> None:
    actuator = record("sweep.csv", seed)
    outcome = run("plant", "sweep", "sweep.csv", "--out", "plant.npz", "--resonance-Hz", 180)
    assert outcome.code == 0, outcome.out + outcome.err
    assert "by the sheet 180 Hz; measured 150 Hz, -17 %" in outcome.out
    assert "nowhere more than the noise" in outcome.out
    assert "fit to design with" in outcome.out
    resonance_Hz, quality, gain = seen("plant.npz")
    assert resonance_Hz == pytest.approx(150, rel=0.002)
    assert quality == pytest.approx(8, rel=0.01)
    assert gain == pytest.approx(actuator.gain, rel=0.01)
    assert str(np.load("plant.npz")["input"]) == "voltage"
    assert Path("plant.png").exists()


def test_a_random_binary_sequence_is_no_clipped_sensor(run: Run) -> None:
    """A generator or an H-bridge puts out a voltage that is at an extreme all the time."""
    actuator, random, rate_Hz = Actuator(), np.random.default_rng(114), 1e4
    volts = np.repeat(random.choice([-1.0, 1.0], 5000), 4)
    volts[:200] = volts[-3000:] = 0.0
    a = actuator.acceleration(np.repeat(volts[:, None], 3, axis=1), 1 / rate_Hz)
    a += 5e-3 * np.abs(a).max() * random.standard_normal(a.size)
    rows = np.transpose([np.arange(a.size) / rate_Hz, volts, a / G])
    np.savetxt("prbs.csv", rows, "%.7g", ",", header="time_s,voltage_V,acceleration_g", comments="")
    outcome = run("plant", "sweep", "prbs.csv", "--out", "plant.npz")
    assert outcome.code == 0, outcome.out + outcome.err
    assert seen("plant.npz")[:2] == pytest.approx((150, 8), rel=0.01)


def test_channels_without_a_known_name_are_named_with_how_to_name_them(run: Run) -> None:
    record("sweep.csv", 115)
    t, u, a = np.loadtxt("sweep.csv", delimiter=",", skiprows=1).T
    rows = np.transpose([1e3 * t, u, 100 * a])
    header = "Time,Channel A,Channel B\n(ms),(V),(mV)\n"
    np.savetxt("pico.csv", rows, "%.9g", ",", header=header, comments="")
    words = ["no column but time", "'Channel A [V], Channel B [mV]' not used", "by --columns"]
    assert_refused(run("plant", "sweep", "pico.csv", "--out", "plant.npz"), *words)
    named = "time [ms],voltage [V],acceleration [mV @ 100 mV/g]"
    assert run("plant", "sweep", "pico.csv", "--out", "plant.npz", "--columns", named).code == 0
    assert seen("plant.npz") == pytest.approx((150, 8, Actuator().gain), rel=0.01)


def test_a_delay_is_no_state_and_is_taken_out(run: Run) -> None:
    record("late.csv", 109, late=10)
    for order in ((), ("--order", 2)):  # eight states follow the delayed response well, two do not
        as_it_is = run("plant", "sweep", "late.csv", "--out", "plant.npz", *order)
        assert_refused(as_it_is, "a dead time of 2 ms", "--delay-s 0.002 --order 2 takes it out", "--accept takes it")
    part_of_it = run("plant", "sweep", "late.csv", "--out", "plant.npz", "--delay-s", "1.6e-3")
    assert_refused(part_of_it, "a dead time of 0.4 ms", "--delay-s 0.002 --order 2")
    assert "accepted as it is" in run("plant", "sweep", "late.csv", "--out", "plant.npz", "--accept").out
    outcome = run("plant", "sweep", "late.csv", "--out", "plant.npz", "--delay-s", "2e-3")
    assert outcome.code == 0, outcome.out + outcome.err
    assert 'file = "plant.npz", and amplifier.delay_s = 0.002' in outcome.out
    assert seen("plant.npz") == pytest.approx((150, 8, Actuator().gain), rel=0.01)
    assert_refused(run("plant", "sweep", "late.csv", "--out", "p.npz", "--delay-s", "2"), "--delay-s 2: must be 0 to")


def test_a_short_sweep_is_named_with_how_long_would_do(run: Run) -> None:
    record("short.csv", 105, seconds=0.3)
    outcome = run("plant", "sweep", "short.csv", "--out", "plant.npz")
    assert outcome.code == 0
    (note,) = [line for line in outcome.out.splitlines() if "its quality is rough" in line]
    record("longer.csv", 106, seconds=float(note.split()[-2]))
    outcome = run("plant", "sweep", "longer.csv", "--out", "plant.npz")
    assert "rough" not in outcome.out
    assert seen("plant.npz")[1] == pytest.approx(8, rel=0.03)


def test_a_noisy_sweep_is_refused_and_a_longer_one_is_not(run: Run) -> None:
    record("noisy.csv", 107, noise=0.6)
    assert_refused(run("plant", "sweep", "noisy.csv", "--out", "plant.npz"), "bands", "louder or longer")
    assert not Path("plant.npz").exists()
    record("louder.csv", 108, noise=0.06)
    assert run("plant", "sweep", "louder.csv", "--out", "plant.npz").code == 0


def test_a_wrong_unit_is_named_against_the_sheet(run: Run) -> None:
    actuator = record("sweep.csv", 109)
    rated_g = abs(actuator.gain * 8 / G)  # at 1 V and the resonance, but for the quadrature's percent
    sheet = ["--resonance-Hz", 150, "--rms-V", 1, "--rms-g", round(rated_g, 4)]
    right = ["plant", "sweep", "sweep.csv", "--out", "plant.npz", *sheet]
    assert run(*right).code == 0
    record("wrong.csv", 109, named="acceleration_m_s2")  # type: ignore[arg-type]
    wrong = ["plant", "sweep", "wrong.csv", "--out", "wrong.npz", *sheet]
    assert_refused(run(*wrong), "0.102 times as much (a factor of 9.807: g and m/s^2?)", "--accept")
    assert not Path("wrong.npz").exists()
    # What is proposed works: the unit stated, or the response taken as it is.
    assert run(*wrong, "--units", "acceleration=g").code == 0
    assert "accepted as it is" in run(*wrong, "--accept").out
    assert_refused(
        run(*right[:-2], "--rms-g", 0.1, "--resonance-Hz", 942), "resonance is 150 Hz", "6.283: rad/s and Hz?"
    )
    assert_refused(run("plant", "sweep", "sweep.csv", "--out", "p.npz", "--rms-g", 1), "state --rms-V")


@pytest.mark.parametrize(("times", "said"), [(1e-3, "0.02 to 20000"), (1e6, "0.02 to 20000")])
def test_a_response_that_no_actuator_has_is_refused(run: Run, times: float, said: str) -> None:
    record("sweep.csv", 110, times=times)
    outcome = run("plant", "sweep", "sweep.csv", "--out", "plant.npz")
    assert_refused(outcome, "the largest response is", said, "(a factor of ", "--accept takes it")
    assert run("plant", "sweep", "sweep.csv", "--out", "plant.npz", "--accept").code == 0


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ("time_s,temperature_C,acceleration_g", "no column voltage_V"),
        ("time_s,voltage_V,position_m", "no column acceleration_m_s2"),
    ],
)
def test_a_missing_column_is_named(run: Run, names: str, said: str) -> None:
    record("sweep.csv", 111, seconds=0.5)
    rows = Path("sweep.csv").read_text().splitlines()
    Path("sweep.csv").write_text("\n".join([names.replace("temperature", "winding"), *rows[1:]]))
    assert_refused(run("plant", "sweep", "sweep.csv", "--out", "plant.npz"), said)


def test_a_clipped_sensor_is_refused(run: Run) -> None:
    record("sweep.csv", 112)
    t, u, a = np.loadtxt("sweep.csv", delimiter=",", skiprows=1).T
    top = 1 + 0.5 * np.abs(a - 1).max()
    header = "time_s,voltage_V,acceleration_g"
    np.savetxt("cut.csv", np.transpose([t, u, np.minimum(a, top)]), "%.7g", ",", header=header, comments="")
    assert_refused(
        run("plant", "sweep", "cut.csv", "--out", "plant.npz"), "samples at the highest value", "wider range"
    )
