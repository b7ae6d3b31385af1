"""`transopt plant fit`, and one device stated in three ways: by a scene, by Python, by its measured response."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import transopt as to
from tests.benches.actuators import HEAD, LIMITS, file_scene, ten_states
from tests.benches.commands import Outcome, Run, assert_refused
from tests.transopt.identify.test_response import G, S, W, table, uff

F_HZ = np.linspace(10, 2000, 120)
SAME = 1e-6  # of the limit, between designs of one device stated in three ways
BY_VOLTAGE = ("--input", "voltage")


def measure(path: str = "response.csv", delay_s: float = 0.0, noise: float = 0.0) -> None:
    """What an analyser would write of the plant of ten states."""
    G = ten_states().response(F_HZ) * np.exp(-2j * np.pi * F_HZ * delay_s)
    random = np.random.default_rng(1)
    G = G + noise * np.sqrt(np.mean(np.abs(G) ** 2) / 2) * (
        random.normal(size=G.size) + 1j * random.normal(size=G.size)
    )
    rows = np.column_stack([F_HZ, 20 * np.log10(np.abs(G)), np.degrees(np.angle(G))])
    np.savetxt(path, rows, delimiter=",", fmt="%.15g", header="frequency_Hz,magnitude_dB,phase_deg", comments="")


@pytest.fixture
def fit(run: Run) -> Callable[..., Outcome]:
    return lambda *options: run("plant", "fit", "response.csv", "--out", "plant.npz", *BY_VOLTAGE, *options)


def in_toml() -> str:
    """The plant of ten states written out in a scene."""
    plant = ten_states()
    outputs = "".join(
        f'[model.outputs."{name}"]\nrow = {output.row[0].tolist()}\nunit = "{output.unit}"\n'
        for name, output in plant.outputs.items()
    )
    matrices = f"A = {plant.A.tolist()}\nB = {plant.B[:, 0].tolist()}\nC = {plant.C[0].tolist()}\n"
    table = f'[model]\nkind = "state_space"\ninput = "voltage"\n{matrices}D = {float(plant.D[0, 0])}\n{outputs}'
    return HEAD.format(peak=PEAK) + table + LIMITS


PEAK = 60.0  # m/s^2: the rail binds


def test_one_device_stated_in_three_ways_has_one_design(fit: Callable[..., Outcome]) -> None:
    measure()
    outcome = fit("--order", "10")
    assert outcome.code == 0, outcome.out + outcome.err
    Path("written.toml").write_text(in_toml(), encoding="utf-8")
    Path("measured.toml").write_text(file_scene("plant.npz", peak_m_s2=PEAK), encoding="utf-8")
    written = to.load_scene("written.toml")
    other = to.load_scene("measured.toml")
    scenes = {"scene": written, "Python": to.with_plant(other, ten_states()), "response": other}
    commands = {name: to.solve(scene).command for name, scene in scenes.items()}
    limit = written.limits.transient_input
    assert np.abs(commands["scene"]).max() == pytest.approx(limit, rel=1e-6), "a limit binds"
    assert np.abs(commands["Python"] - commands["scene"]).max() < SAME * limit
    # What the fit leaves of an exact response, 1e-9 of it, is as little in the design.
    assert np.abs(commands["response"] - commands["scene"]).max() < SAME * limit


def test_it_says_what_was_found_and_what_comes_next(fit: Callable[..., Outcome]) -> None:
    measure()
    outcome = fit("--order", "10")
    assert "10 states to 120 points, 10 to 2000 Hz" in outcome.out
    assert "resonances: 60 Hz (Q 4), 140 Hz (Q 8), 310 Hz (Q 12), 520 Hz (Q 10), 900 Hz (Q 15)" in outcome.out
    assert "no acceleration under a constant input" in outcome.out
    assert "fit to design with; next" in outcome.out
    assert Path("plant.png").stat().st_size > 10_000
    with np.load("plant.npz") as file:
        assert str(file["input"]) == "voltage"
        assert file["A"].shape == (10, 10)


def test_a_poor_fit_is_not_fit_to_design_with(fit: Callable[..., Outcome]) -> None:
    measure()
    outcome = fit("--order", "4")
    assert outcome.code == 1
    assert "not fit to design with: misfit" in outcome.out
    assert "--order 6 for a resonance more" in outcome.out
    assert Path("plant.png").exists()
    assert not Path("plant.npz").exists()


def test_a_delay_is_no_state_and_is_taken_out(fit: Callable[..., Outcome]) -> None:
    measure(delay_s=4e-4)
    assert_refused(fit("--order", "10"), "a dead time of 0.4 ms", "--delay-s 0.0004 --order 10 takes it out")
    assert fit("--order", "10", "--delay-s", "4e-4").code == 0


def test_a_phase_of_the_other_sign_is_named_with_the_unit_that_turns_it(fit: Callable[..., Outcome]) -> None:
    measure()
    rows = np.loadtxt("response.csv", delimiter=",", skiprows=1)
    names = "frequency_Hz,magnitude_dB,phase_deg"
    np.savetxt("response.csv", rows * [1, 1, -1], delimiter=",", fmt="%.15g", header=names, comments="")
    assert_refused(fit("--order", "10"), "the phase has the other sign", "next: --units phase=-deg;")
    outcome = fit("--order", "10", "--units", "phase=-deg")
    assert outcome.code == 0, outcome.out + outcome.err
    with np.load("plant.npz") as file:
        found = to.StateSpace(*(file[name] for name in "ABCD"))
    np.testing.assert_allclose(found.response(F_HZ), ten_states().response(F_HZ), rtol=1e-4)


def test_a_complex_response_of_the_other_sign_is_to_be_saved_as_its_conjugate(run: Run) -> None:
    for name, response in (
        ("turned.npz", ten_states().response(F_HZ).conj()),
        ("right.npz", ten_states().response(F_HZ)),
    ):
        np.savez(name, frequency_Hz=F_HZ, magnitude=response)
    fit = ("--order", "10", "--out", "plant.npz", *BY_VOLTAGE)
    assert_refused(run("plant", "fit", "turned.npz", *fit), "the other sign", "next: save its complex conjugate;")
    assert run("plant", "fit", "right.npz", *fit).code == 0


def test_imaginary_parts_of_the_other_sign_are_turned_too(fit: Callable[..., Outcome]) -> None:
    order = "10"
    G = ten_states().response(F_HZ)
    rows = np.column_stack([F_HZ, G.real, -G.imag])
    np.savetxt("response.csv", rows, delimiter=",", fmt="%.15g", header="frequency_Hz,real,imaginary", comments="")
    turning = "real=m/s^2/V,imaginary=-m/s^2/V"
    assert_refused(fit("--order", order), "the phase has the other sign", f"next: --units {turning};")
    assert fit("--order", order, "--units", turning).code == 0
    # Turned without need, it is turned back.
    rows[:, 2] *= -1
    np.savetxt("response.csv", rows, delimiter=",", fmt="%.15g", header="frequency_Hz,real,imaginary", comments="")
    back = "--units real=m/s^2/V,imaginary=m/s^2/V;"
    assert_refused(fit("--order", order, "--units", turning), "the phase has the other sign", back)


def test_a_band_and_a_scale(fit: Callable[..., Outcome], run: Run) -> None:
    measure()
    outcome = fit("--order", "8", "--band-Hz", "30", "400", "--scale", "9.80665")
    assert outcome.code == 0, outcome.out
    assert "22 points, 43.45 to 394.6 Hz" in outcome.out
    with np.load("plant.npz") as file:
        found = to.StateSpace(*(file[name] for name in "ABCD"))
    f = np.linspace(40, 390, 50)
    expected = 9.80665 * ten_states().response(f)
    np.testing.assert_allclose(found.response(f), expected, atol=0.05 * np.abs(expected).max())


def in_g(name: str) -> None:
    """A resonance at 150 Hz, in g per volt by its labels."""
    found = np.asarray(G / 9.80665)
    if name.endswith("uff"):
        Path(name).write_text(uff(6, even=True, response=found, units=("Hz", "g", "V")))
    else:
        table(
            Path(name),
            "f [Hz],Mag [g/V],phase_deg",
            np.abs(S.imag) / (2 * np.pi),
            abs(found),
            np.degrees(np.angle(found)),
        )


@pytest.mark.parametrize("name", ["r.uff", "r.csv"])
class TestLabels:
    def fitted(self, run: Run, name: str, *options: str) -> Outcome:
        in_g(name)
        return run("plant", "fit", name, "--order", "2", "--out", "plant.npz", *options)

    def test_decide_the_input_and_the_gain_of_the_plant(self, run: Run, name: str) -> None:
        for options in ((), BY_VOLTAGE):
            outcome = self.fitted(run, name, *options)
            assert outcome.code == 0, outcome.err
            assert "--units says" not in outcome.out
            with np.load("plant.npz") as file:
                assert str(file["input"]) == "voltage"
                found = to.StateSpace(*(file[matrix] for matrix in "ABCD"))
            # 3.0 Q m/s^2 per volt at the resonance, which would be 9.81 times less if g were read as m/s^2.
            assert abs(found.response(np.array([W / (2 * np.pi)]))[0]) == pytest.approx(24.0, rel=1e-3)

    def test_and_a_scale_besides_are_said(self, run: Run, name: str) -> None:
        outcome = self.fitted(run, name, "--scale", "9.80665")
        assert outcome.code == 0, outcome.err
        assert "g/V is converted to m/s^2 per A or V, and --scale 9.80665 multiplies besides" in outcome.out


def test_refusals(fit: Callable[..., Outcome], run: Run) -> None:
    measure()
    assert_refused(fit("--order", "4", "--delay-s", "-1"), "--delay-s -1: must be 0 to 1 s")
    assert_refused(fit("--order", "99"), "--order 99: must be 1 to 40")
    assert_refused(fit("--order", "4", "--scale", "0"), "--scale 0.0: must be a number other than 0")
    gone = run("plant", "fit", "gone.csv", "--order", "4", "--out", "plant.npz")
    assert_refused(gone, "gone.csv: no such file")
    other = run("plant", "fit", "response.csv", "--order", "4", "--out", "plant.json")
    assert_refused(other, "--out plant.json", "ends in .npz")
    force = run("plant", "fit", "response.csv", "--order", "4", "--out", "p.npz", "--input", "force")
    assert_refused(force, "--input force: unknown; choose current, voltage")
