"""Scenes with identified parts, and what a spectrum of errors makes of a tap."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

import problems
from controller.sim.true_device import device_of
from problems.generators.tapping_trials import FOURTH_ORDER_HAND, FOURTH_ORDER_STYLUS_KG
from tests.benches.model_parts import (
    BOX,
    DRIVE,
    GRIPS_N,
    ON_FILE,
    POLE,
    ROBUST,
    SMALL,
    WOOD,
    Make,
    Parts,
    amplifier_part,
    assert_clean,
    built,
    coil_part,
    drive_device,
    fourth_order_hand,
    hand_part,
    solved,
    state_space_device,
)
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.base.writing import percent
from transopt.design.build import Build, build_library
from transopt.design.solve import solve
from transopt.library.file import load_library
from transopt.library.library import Library
from transopt.plant.fourth_order import fourth_order
from transopt.plant.second_order import second_order
from transopt.recordings.recording import Recording
from transopt.report.identified import below_the_model, model_warning
from transopt.report.markdown import build_markdown
from transopt.report.report_json import build_json
from transopt.scene.file import with_model
from transopt.scene.identified import IdentifiedModel
from transopt.scene.keys import find_key, keys, with_values
from transopt.scene.model_error import AtUse, ModelError, Predicted
from transopt.scene.model_file import load_model
from transopt.scene.model_parts import DriveDevice
from transopt.scene.scene import Scene


class TestTheSameDevice:
    def test_by_its_true_parameters_gives_the_same_library(
        self, make: Make, library: Library, taps: list[Recording], tmp_path: Path
    ) -> None:
        parts: Parts = {"device": drive_device(), "amplifier": amplifier_part(), "coil": coil_part()}
        scene = make(ON_FILE, parts, (POLE, ""))
        own = solved(scene, taps)
        for name in (
            "command",
            "acceleration_m_s2",
            "tap_error",
            "floor",
            "objective",
            "peak_temperature_C",
            "plant_A",
        ):
            ours, theirs = getattr(own, name), getattr(library, name)
            assert np.abs(ours - theirs).max() <= 1e-9 * max(np.abs(theirs).max(), 1), name
        assert own.amplifier() == library.amplifier()
        assert own.posing().circuit == library.posing().circuit
        own.save(tmp_path / "library.npz")
        (tmp_path / "MODEL.json").unlink()  # the library needs it no more
        assert_clean(load_library(tmp_path / "library.npz"))

    def test_put_into_a_scene_is_the_scene_that_names_it(self, make: Make, scene: Scene, tmp_path: Path) -> None:
        named = make(ON_FILE, {"device": drive_device(), "amplifier": amplifier_part()}, (POLE, ""))
        put = with_model(scene, tmp_path / "MODEL.json")
        assert put.amplifier_model() == named.amplifier_model()
        assert put.model.model_copy(update={"file": named.model.file}) == named.model
        with pytest.raises(InputError, match=r"grid\.grips_N: 9 N"):
            with_model(with_values(scene, {"grid.grips_N": [9.0]}), tmp_path / "MODEL.json")
        with pytest.raises(InputError, match=r"absent\.json"):
            with_model(scene, tmp_path / "absent.json")

    def test_as_a_black_box_gives_the_same_at_the_nodes(
        self, make: Make, library: Library, taps: list[Recording]
    ) -> None:
        own = solved(make(BOX, {"device": state_space_device()}), taps)
        for name in ("command", "acceleration_m_s2", "tap_error", "floor"):
            ours, theirs = getattr(own, name), getattr(library, name)
            assert np.abs(ours - theirs).max() <= 1e-7 * max(np.abs(theirs).max(), 1), name
        assert own.plant_A.shape == (3, 12, 12)
        assert not own.plant_Ce.any()
        assert_clean(own)

    def test_a_black_box_is_designed_for_between_its_grips(self, make: Make, taps: list[Recording]) -> None:
        scene = make(BOX, {"device": state_space_device()}, SMALL, ("[1.0, 3.0, 5.0]", "[1.0, 1.7, 5.4]"))
        own = solved(scene, taps)
        assert_clean(own)
        f = np.array([3.0, 80.0, 400.0])
        by_node = [scene.plant(grip).response(f) for grip in (1.0, 3.0)]
        assert np.allclose(scene.plant(1.7).response(f), 0.65 * by_node[0] + 0.35 * by_node[1], rtol=1e-12)

    def test_free_and_held_devices_are_never_blended(self, make: Make) -> None:
        device = state_space_device(grips_N=[1.0, 3.0])
        damped = [[[-5.0 if i == j else 0.0 for j in range(6)] for i in range(6)]]
        content = device.model_dump() | {"grips_N": [0.0, 1.0, 3.0], "A": damped + device.A}
        for name in "BCD":
            content[name] = content[name][:1] + content[name]
        whole = type(device).model_validate(content)
        assert whole.plant(0.0).order == 6
        f = np.array([30.0])
        assert np.allclose(whole.plant(0.95).response(f), device.plant(1.0).response(f), rtol=1e-12)

    def test_hand_alone_takes_the_place_of_the_seed(self, make: Make) -> None:
        moved = hand_part().with_values(hand_part().values() * 1.1)
        scene = make(ON_FILE, {"hand": moved})
        expected = second_order(
            3.0,
            force_per_current_N_A=scene.drive_at_tip().force_per_current_N_A,
            mass_kg=moved.mass_kg.linear(),
            damping_N_s_m=moved.damping_N_s_m.linear(),
            stiffness_N_m=moved.stiffness_N_m.linear(),
        )
        assert np.array_equal(scene.plant(3.0).A, expected.A)
        device = device_of(scene)
        masses, stiffness, damping = device.at(3.0)
        assert -stiffness[0] / masses[0] == pytest.approx(expected.A[1, 0])
        assert -damping[0] / masses[0] == pytest.approx(expected.A[1, 1])

    def test_a_hand_of_fourth_order_is_the_chain_of_its_own_masses(self, make: Make, taps: list[Recording]) -> None:
        """In solve, in the simulator and in studies; the stylus' mass is all that moves with it."""
        scene = make(ON_FILE, {"hand": fourth_order_hand()}, SMALL, ("[1.0, 3.0, 5.0]", "[2.0]"))
        expected = fourth_order(
            2.0,
            hand=FOURTH_ORDER_HAND,
            stylus_mass_kg=FOURTH_ORDER_STYLUS_KG,
            moving_mass_kg=0.0,
            force_per_current_N_A=scene.drive_at_tip().force_per_current_N_A,
        )
        halved = with_values(scene, {"limits.current_A": 2.0})
        for one in (scene, halved):
            assert np.allclose(one.plant(2.0).A, expected.A, rtol=1e-12)
        masses, _, _ = device_of(scene).at(2.0)
        assert masses.tolist() == [FOURTH_ORDER_STYLUS_KG, FOURTH_ORDER_HAND.line("mass_kg").at(2.0)]
        own = built(scene, taps)
        assert own.library is not None
        assert_clean(own.library)
        assert "- hand: stylus, skin, hand mass and arm (seed Fig. 4b)" in build_markdown(own, full=False)
        # Deviations of 2 % of its parameters are errors of a few percent of a tap.
        [entry] = own.all_entries()
        energy = float(np.sum(entry.predicted_m_s2**2))
        force = scene.drive_at_tip().force_per_current_N_A
        error = scene.model.error_of(2.0, entry.plant_input, 1e-4, energy, force_per_current_N_A=force)
        assert 0.005 < error < 0.1
        assert f"model error {percent(error)} % of a tap" in model_warning(own)

    def test_the_simulator_knows_the_identified_chain(self, make: Make, scene: Scene) -> None:
        identified = make(ON_FILE, {"device": drive_device()})
        assert device_of(identified) == device_of(scene)

    def test_the_coil_is_the_identified_one(self, make: Make) -> None:
        coil = make(ON_FILE, {"device": drive_device(), "coil": coil_part(R_wh_K_W=4.5, tau_w_s=20.0)}).coil()
        assert (coil.R_ohm, coil.R_wh_K_W, coil.tau_w_s, coil.tau_h_s) == (2.18, 4.5, 20.0, 612.0)
        heated = make(ON_FILE, {"device": drive_device(), "coil": coil_part(R_ohm=2.5)})
        assert (heated.coil().R_ohm, heated.circuit().R_ohm) == (2.5, 2.18)

    def test_without_a_motor_there_is_a_device_but_no_coil(self, make: Make, taps: list[Recording]) -> None:
        scene = make(ON_FILE, {"device": drive_device()}, (DRIVE, ""), SMALL)
        assert scene.coil() is None
        assert scene.circuit() is None
        assert scene.drive_at_tip().force_per_current_N_A == drive_device().force_per_current_N_A
        assert_clean(solved(scene, taps))


WALL = "\n[feedback]\nstiffness_N_m = 200.0\n"
TIP = "\n[tip]\nforce_per_current_N_A = 1.25\nmoving_mass_kg = 0.014\n"


@pytest.mark.parametrize(
    ("text", "parts", "changes", "more", "message"),
    [
        (ON_FILE, {"device": drive_device()}, [(POLE, "")], "", r"amplifier\.pole_Hz: missing"),
        (ON_FILE, {"device": drive_device()}, [("delay_s = 68e-6\n", "")], "", r"amplifier\.delay_s: missing"),
        (
            ON_FILE,
            {"device": drive_device(), "amplifier": amplifier_part(990.0)},
            [],
            "",
            r"amplifier\.pole_Hz = 1050: MODEL\.json has it too \(990\)",
        ),
        (
            ON_FILE,
            {"device": drive_device(), "amplifier": amplifier_part()},
            [("[amplifier]\n" + POLE + "command_limit_A = 6.0\n", ""), ("model =", 'amplifier = "ideal"\nmodel =')],
            "",
            "'ideal': MODEL.json has an amplifier part",
        ),
        (ON_FILE, {"coil": coil_part()}, [], "", "neither a device nor a hand part"),
        (ON_FILE, {"device": drive_device()}, [("3.0, 5.0]", "3.0, 6.0]")], "", r"6 N: outside .*, 1 to 5 N"),
        (ON_FILE, {"device": drive_device()}, [("[1.0, 3.0, 5.0]", "[0.0]")], "", "has no free device"),
        (ON_FILE, {"device": drive_device()}, [], "\n[robust]\ngrip_spread = 0.3\n", "0.7 N: outside"),
        (ON_FILE, {"device": drive_device()}, [(DRIVE, "")], TIP, "tip: the device in MODEL.json includes the drive"),
        (
            ON_FILE,
            {"device": drive_device().model_copy(update={"force_per_current_N_A": 1.27})},
            [],
            "",
            r"transmission\.ratio_1_m = 1\.25 N/A, but MODEL\.json .* = 1\.27 N/A: they must agree within 1%",
        ),
        (ON_FILE, {"hand": hand_part()}, [(DRIVE, "")], "", "give exactly one"),
        (ON_FILE, {"device": drive_device()}, [('model = "MODEL', 'model = "OTHER')], "", "OTHER.json: no such file"),
        (BOX, {"device": state_space_device()}, [], WALL, "feedback: needs the motor's motion"),
        (
            BOX,
            {"device": state_space_device()},
            [("beta = 3.2", "supply_V = 24.0\nbeta = 3.2")],
            "",
            r"limits\.supply_V: needs the motor's motion",
        ),
        (BOX, {"device": state_space_device()}, [], ROBUST, r"robust\.model_uncertainty: .*no covariance"),
        (ON_FILE, {"device": state_space_device()}, [], "", r"recordings\.simulated: .*no stylus"),
        (WOOD, {}, [], ROBUST, r"robust\.model_uncertainty: needs a model file"),
        (ON_FILE, {"device": drive_device()}, [], "\n[robust]\nsamples = 3\n", "give grip_spread, model_uncertainty"),
        (
            ON_FILE,
            {"device": drive_device(3.0)},
            [],
            ROBUST.replace("4", "15"),
            r"robust\.model_uncertainty: .*record more and identify again",
        ),
    ],
)
def test_what_contradicts_is_refused_by_name(
    make: Make, text: str, parts: Parts, changes: list[tuple[str, str]], more: str, message: str
) -> None:
    with pytest.raises(InputError, match=message) as caught:
        make(text, parts, *changes, more=more)
    assert "mine.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_line_below_a_table_is_told_where_it_belongs(make: Make) -> None:
    below = ("[limits]", 'model = "MODEL.json"\n[limits]')
    with pytest.raises(InputError, match=r"amplifier\.model: .* above the first \[table\]"):
        make(ON_FILE, {"device": drive_device()}, ('model = "MODEL.json"\n', ""), below)


def test_a_damaged_model_file_is_named_with_its_scene(make: Make, tmp_path: Path) -> None:
    make(ON_FILE, {"device": drive_device()})
    content = json.loads((tmp_path / "MODEL.json").read_text())
    content["device"]["moving_mass_kg"] = -1
    (tmp_path / "MODEL.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"MODEL\.json: device\.moving_mass_kg = -1"):
        problems.load(tmp_path / "mine.toml")


def test_keys_of_a_scene_on_a_model_file(make: Make) -> None:
    scene = make(ON_FILE, {"device": drive_device()})
    paths = {key.path: key for key in keys(scene)}
    assert paths["model.device.moving_mass_kg"].unit == "kg"
    assert not [path for path in paths if "covariance" in path or "tap_error" in path or "sources" in path]
    assert with_values(scene, {"limits.beta": 2.0}).limits.transient_input == 2.5
    heavier = with_values(scene, {"model.device.stylus_mass_kg": 0.05})
    assert isinstance(heavier.model, IdentifiedModel)
    np.testing.assert_allclose(heavier.plant(3.0).C, scene.plant(3.0).C * 0.026 / 0.05)
    assert find_key(scene, "amplifier.pole_Hz").value == 1050.0
    with pytest.raises(InputError, match=r"grid\.grips_N: 9 N: outside"):
        with_values(scene, {"grid.grips_N": [1.0, 9.0]})


class TestReport:
    @pytest.fixture
    def identified(self, make: Make, taps: list[Recording]) -> Build:
        parts: Parts = {
            "device": drive_device(nrmse=0.2, grips_N=[1.00009, 2.99998, 4.99998]),
            "amplifier": amplifier_part().model_copy(update={"gain": 1.05}),
            "hand": hand_part(),
            "coil": coil_part(),
        }
        slower = ("speeds_m_s = [0.1, 0.2, 0.3, 0.4]", "speeds_m_s = [0.2, 0.4]")
        return built(make(ON_FILE, parts, (POLE, ""), slower, ("5.0]", "5.4]")), taps)

    def test_says_what_was_identified_and_how_well(self, identified: Build, tmp_path: Path) -> None:
        text = build_markdown(identified, full=False)
        section = text[text.index("## Identified") : text.index("## Left out")]
        assert "| device | transmission_stiffness_N_m | 6e+04 | 5.76e+04 to 6.24e+04 | 1.2e+03 |" in section
        assert "- coil: thermal resistances and time constants, in place of the motor's. good to 1 %" in section
        assert "gain of 1.05 is NOT in the design" in section
        assert "- hand: not used: the device has its own" in section
        assert "Outside the recorded grips, 1 to 5 N, but within the tenth that is allowed: 5.4 N" in section
        assert "1 N: 20.0 %" in section
        rows = json.loads(build_json(identified))["identified"]
        assert rows["parts"]["coil"]["values"]["tau_w_s"] == 12.0
        assert rows["sha256"] == digest(tmp_path / "MODEL.json")

    def test_warns_where_the_design_promises_more_than_the_model_knows(self, identified: Build) -> None:
        below = {(entry.speed_m_s, entry.grip_N) for entry in below_the_model(identified)}
        assert below == {(e.speed_m_s, e.grip_N) for e in identified.all_entries() if e.figures.tap_error < 0.2}
        assert len(below) == 2
        assert "above the design's own in 2 of 6 entries" in model_warning(identified)
        assert "model error 20.0 % of a tap" in model_warning(identified)
        assert build_markdown(identified, full=False).count("Model error 20.0 %") == 1
        assert "not counted" not in model_warning(identified)

    def test_sources_name_the_model_file_and_what_it_was_fitted_to(self, identified: Build, tmp_path: Path) -> None:
        sources = identified.library.meta["sources"]
        [own] = [source for source in sources if source["origin"] == "model file"]
        assert own["sha256"] == digest(tmp_path / "MODEL.json")
        fitted = [source["origin"].split()[0] for source in sources if "identified from" in source["origin"]]
        assert fitted == ["amplifier", "device", "hand", "coil"]
        held = identified.library.meta["scene"]["model"]
        assert held["device"] == load_model(tmp_path / "MODEL.json").device.model_dump(mode="json")

    def test_a_scene_without_a_model_file_says_nothing(self, build: Build) -> None:
        assert "Identified" not in build_markdown(build, full=False)
        assert json.loads(build_json(build))["identified"] is None
        assert model_warning(build) == ""


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def with_error(relative: float, excess: float) -> DriveDevice:
    """The chain, known to 0.1 %, by records that show an error of the response and, at full current, of a tap."""
    part = drive_device(1e-3)
    bands = np.geomspace(2.0, 1000.0, 30)
    power = [(relative**2 * np.abs(part.plant(grip).response(bands)) ** 2).tolist() for grip in part.grips_N]
    error = ModelError(
        grips_N=part.grips_N,
        frequencies_Hz=bands.tolist(),
        power=power,
        at_use=[AtUse(grip_N=grip, peak_A=3.0, excess=excess) for grip in part.grips_N],
    )
    return part.model_copy(update={"error": error})


class TestSpread:
    """Devices that a robust design serves are as far off as the model file's own verdict says."""

    @pytest.mark.parametrize(("relative", "excess"), [(1e-4, 0.05), (0.05, 0.0)])
    def test_as_far_as_the_verdict(self, make: Make, relative: float, excess: float) -> None:
        scene = make(ON_FILE + ROBUST, {"device": with_error(relative, excess)})
        model = scene.model
        assert isinstance(model, IdentifiedModel)
        bands = np.geomspace(5.0, 600.0, 40)

        def response(device: IdentifiedModel, grip_N: float) -> np.ndarray:
            return np.asarray(device.plant(grip_N, None).response(bands))

        off = [
            float(np.mean(np.abs(response(device, grip) / response(model, grip) - 1) ** 2))
            for device in model.drawn(40, GRIPS_N)
            for grip in GRIPS_N
        ]
        assert np.sqrt(np.mean(off)) == pytest.approx(0.05, rel=0.35)

    def test_never_nearer_than_the_covariance(self, make: Make) -> None:
        scene = make(ON_FILE + ROBUST, {"device": with_error(1e-9, 0.0)})
        assert isinstance(scene.model, IdentifiedModel)
        assert scene.model.stretch == pytest.approx(1.0)

    def test_it_changes_commands_where_it_should(self, make: Make, taps: list[Recording]) -> None:
        def commands(part: DriveDevice) -> FloatArray:
            library = build_library(make(ON_FILE + ROBUST, {"device": part}), taps).library
            return library.command

        sure, unsure = commands(with_error(1e-9, 0.0)), commands(with_error(1e-4, 0.1))
        assert np.linalg.norm(unsure - sure) > 5e-3 * np.linalg.norm(sure)


def test_python_refuses_an_unfit_model_too(make: Make, taps: list[Recording]) -> None:
    part = drive_device().model_copy(update={"shortfalls": ["3 N: predicted to miss 12 %"]})
    scene = make(ON_FILE, {"device": part})
    with pytest.raises(InputError, match=r"not fit to design with: device: 3 N: .*accept_unfit_model=True"):
        solve(scene, taps)
    assert solve(scene, taps, accept_unfit_model=True).command.shape[0] == 4


DT_S = 1e-4


def pulse(peak_A: float = 2.0) -> np.ndarray:
    times = DT_S * np.arange(600)
    return peak_A * np.exp(-times / 5e-3) * np.sin(2 * np.pi * 100 * times)


def test_the_error_of_a_resonance_that_the_model_lacks_is_that_of_the_missing_answer() -> None:
    """Against the time domain: the answer of the missing part to the pulse, by its convolution."""
    frequencies = np.geomspace(1, 4999, 200)
    s, w = 2j * np.pi * frequencies, 2 * np.pi * 250.0
    missing = 0.5 * s**2 / (s**2 + 0.2 * w * s + w**2)  # m/s^2/A
    error = ModelError(grips_N=[3.0], frequencies_Hz=frequencies.tolist(), power=[(np.abs(missing) ** 2).tolist()])
    given, energy, size = pulse(), 5000.0, 6000
    lines = 2j * np.pi * np.fft.rfftfreq(size, DT_S)
    answer = np.fft.irfft(np.fft.rfft(given, size) * 0.5 * lines**2 / (lines**2 + 0.2 * w * lines + w**2), size)
    expected = np.sqrt(np.sum(answer**2) / energy)
    assert error.nrmse(3.0, given, DT_S, energy) == pytest.approx(expected, rel=0.02)


def test_between_recorded_grips_the_power_is_linear_and_the_free_device_apart() -> None:
    error = ModelError(grips_N=[0.0, 1.0, 3.0], frequencies_Hz=[10.0], power=[[100.0], [1.0], [3.0]])
    found = [error.nrmse(grip, pulse(), DT_S, 1.0) ** 2 for grip in (0.0, 0.5, 1.0, 2.0, 3.0)]
    np.testing.assert_allclose(np.array(found) / found[2], [100.0, 1.0, 1.0, 2.0, 3.0], rtol=1e-9)


def test_what_taps_missed_at_full_current_is_added_by_grip_and_peak() -> None:
    taps = [AtUse(grip_N=grip, peak_A=peak, excess=0.01 * grip * peak) for grip in (1.0, 3.0) for peak in (1.0, 4.0)]
    error = ModelError(grips_N=[3.0], frequencies_Hz=[10.0], power=[[0.0]], at_use=taps)
    for grip, peak, expected in ((1.0, 4.0, 0.04), (3.0, 2.0, 0.06), (2.0, 4.0, 0.08), (3.0, 9.0, 0.12)):
        given = pulse()
        given *= peak / np.abs(given).max()
        assert error.nrmse(grip, given, DT_S, 1.0) == pytest.approx(expected)


@pytest.mark.parametrize(
    "spoilt",
    [
        {"frequencies_Hz": [20.0, 10.0]},
        {"power": [[1.0]]},
        {"power": [[1.0, -1.0]]},
        {"frequencies_Hz": [0.0, 10.0]},
        {"power": [[1.0, float("nan")]]},
    ],
)
def test_what_is_no_spectrum_is_refused(spoilt: dict[str, object]) -> None:
    whole = {"grips_N": [3.0], "frequencies_Hz": [10.0, 20.0], "power": [[1.0, 1.0]]}
    ModelError.model_validate(whole)
    with pytest.raises(ValidationError):
        ModelError.model_validate({**whole, **spoilt})


def test_the_worst_tap_is_named() -> None:
    predicted = Predicted(speeds_m_s=[0.1, 0.2], grips_N=[1.0, 3.0], nrmse=[[0.01, 0.02], [0.05, 0.03]])
    assert predicted.worst == (0.05, 0.1, 3.0)
