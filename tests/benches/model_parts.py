"""Parts of model files for tests: the default device as an identification without any error would find it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import problems
from problems.generators.tapping_trials import FOURTH_ORDER_HAND, FOURTH_ORDER_STYLUS_KG
from transopt.design.build import Build, build_library
from transopt.design.verify import verify_library
from transopt.library.library import Library
from transopt.plant.drive import Drive
from transopt.plant.second_order import SEED_HAND_DAMPING_N_S_M, SEED_HAND_MASS_KG, SEED_HAND_STIFFNESS_N_M
from transopt.recordings.recording import Recording
from transopt.scene.model_file import save_part
from transopt.scene.model_parts import (
    AmplifierPart,
    AnyModelPart,
    CoilPart,
    DriveDevice,
    FourthOrderHand,
    ModelPartName,
    SecondOrderHand,
    StateSpaceDevice,
)
from transopt.scene.scene import Scene

GRIPS_N = [1.0, 3.0, 5.0]
SOURCES = [{"file": "sweep.npz", "sha256": "0" * 64}]
ABOUT = {"verdict": "good to 1 %", "sources": SOURCES}
HAND = ("mass_kg", "skin_stiffness_N_m", "skin_damping_N_s_m", "arm_stiffness_N_m", "arm_damping_N_s_m")
FITTED = (
    "moving_mass_kg",
    "stylus_mass_kg",
    "transmission_stiffness_N_m",
    "transmission_damping_N_s_m",
    *(f"hand.{name}.{coefficient}" for name in HAND for coefficient in ("constant", "per_newton")),
)


def fit(values: dict[str, float], deviation: float) -> dict[str, Any]:
    """Independent errors, each of a share `deviation` of its value."""
    sizes = np.array([deviation * abs(value) for value in values.values()])
    return {
        "parameters": list(values),
        "covariance": np.diag(sizes**2).tolist(),
        "intervals": {n: (v - 2 * s, v + 2 * s) for (n, v), s in zip(values.items(), sizes, strict=True)},
        **ABOUT,
    }


def drive_device(deviation: float = 0.02, *, nrmse: float = 0.01, grips_N: list[float] = GRIPS_N) -> DriveDevice:
    """The chain of the default scene, by its own parameters."""
    scene = problems.load("wood_on_foam")
    tip, section = scene.drive_at_tip(), scene.model
    assert isinstance(section, Drive)
    hand = section.hand
    content: dict[str, Any] = {
        "kind": "drive",
        "force_per_current_N_A": tip.force_per_current_N_A,
        "moving_mass_kg": tip.moving_mass_kg,
        "stylus_mass_kg": section.stylus_mass_kg,
        "transmission_stiffness_N_m": tip.stiffness_N_m,
        "transmission_damping_N_s_m": tip.damping_N_s_m,
        "hand": {name: vars(hand.line(name)) for name in HAND},
        "grips_N": grips_N,
        "nrmse": {f"{grip:g}": nrmse for grip in grips_N},
    }
    fitted = {name: value for name in FITTED if (value := _at(content, name)) != 0}
    return DriveDevice.model_validate({**content, **fit(fitted, deviation)})


def _at(content: dict[str, Any], name: str) -> float:
    for key in name.split("."):
        content = content[key]
    return content  # type: ignore[return-value]


def state_space_device(*, nrmse: float = 0.01, grips_N: list[float] = GRIPS_N) -> StateSpaceDevice:
    """State the device of the default scene as a black box of one model per grip."""
    scene = problems.load("wood_on_foam")
    plants = [scene.plant(grip) for grip in grips_N]
    matrices = {name: [getattr(plant, name).tolist() for plant in plants] for name in "ABCD"}
    nrmse_by_grip = {f"{grip:g}": nrmse for grip in grips_N}
    return StateSpaceDevice.model_validate(
        {
            "kind": "state_space",
            "order": plants[0].order,
            "grips_N": grips_N,
            **matrices,
            "nrmse": nrmse_by_grip,
            **ABOUT,
        }
    )


def amplifier_part(pole_Hz: float = 1050.0, delay_s: float = 68e-6) -> AmplifierPart:
    fitted = fit({"pole_Hz": pole_Hz, "delay_s": delay_s}, 0.01)
    return AmplifierPart(pole_Hz=pole_Hz, delay_s=delay_s, delay_with_hold_s=delay_s + 5e-5, gain=1.0, **fitted)


def hand_part(deviation: float = 0.02) -> SecondOrderHand:
    """The seed's whole hand."""
    tables = {
        "mass_kg": vars(SEED_HAND_MASS_KG),
        "damping_N_s_m": vars(SEED_HAND_DAMPING_N_S_M),
        "stiffness_N_m": vars(SEED_HAND_STIFFNESS_N_M),
    }
    values = {f"{name}.{key}": value for name, table in tables.items() for key, value in table.items()}
    kind = {"kind": "second_order", "grips_N": [1.0, 7.0]}
    return SecondOrderHand.model_validate({**kind, **tables, **fit(values, deviation)})


def fourth_order_hand(deviation: float = 0.02) -> FourthOrderHand:
    """The hand of the simulated trials, by the seed's Fig. 4b."""
    tables = {name: vars(FOURTH_ORDER_HAND.line(name)) for name in HAND}
    values = {f"hand.{name}.{key}": value for name, table in tables.items() for key, value in table.items()}
    values |= {"stylus_mass_kg": FOURTH_ORDER_STYLUS_KG}
    kind = {"kind": "fourth_order", "grips_N": [1.0, 7.0], "stylus_mass_kg": FOURTH_ORDER_STYLUS_KG}
    return FourthOrderHand.model_validate({**kind, "hand": tables, **fit(values, deviation)})


def coil_part(**values: float) -> CoilPart:
    known = {"R_wh_K_W": 3.1, "R_ha_K_W": 14.0, "tau_w_s": 12.0, "tau_h_s": 612.0, **values}
    return CoilPart(**known, **fit(known, 0.03))  # type: ignore[arg-type]


WOOD = problems.scene_path("wood_on_foam").read_text()
MODEL = WOOD[WOOD.index("[model]") : WOOD.index("[amplifier]")]
POLE = "pole_Hz = 1050.0\ndelay_s = 68e-6\n"
SIMULATED = WOOD[WOOD.index("# The undriven") : WOOD.index("[model]")]
DRIVE = WOOD[WOOD.index("motor = ") : WOOD.index("hand_over_samples")]
ON_FILE = 'model = "MODEL.json"\n' + WOOD.replace(MODEL, "")
# A black box cannot strike an object; the tests bring the recordings themselves.
BOX = ON_FILE.replace(SIMULATED, 'files = ["tap.csv"]\n\n')
SMALL = ("speeds_m_s = [0.1, 0.2, 0.3, 0.4]", "speeds_m_s = [0.4]")
Parts = dict[ModelPartName, AnyModelPart]
Make = Callable[..., Scene]
ROBUST = "\n[robust]\nmodel_uncertainty = true\nsamples = 4\n"


def scene_on(folder: Path, text: str, parts: Parts, *changes: tuple[str, str], more: str = "") -> Scene:
    """A scene of a text and a model file of parts; `changes` are pairs of what to replace in the text."""
    for name, part in parts.items():
        save_part(folder / "MODEL.json", name, part)
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "mine.toml").write_text(text + more)
    return problems.load(folder / "mine.toml")


def built(scene: Scene, taps: list[Recording]) -> Build:
    """Build a scene's library from those of the default scene's taps that have one of its speeds."""
    speeds = scene.grid.speeds_m_s
    return build_library(
        scene, [tap for tap in taps if min(abs((tap.speed_m_s or 0) / v - 1) for v in speeds) < 0.15]
    )


def solved(scene: Scene, taps: list[Recording]) -> Library:
    build = built(scene, taps)
    assert build.library is not None, [entry.shortfalls for entry in build.refused]
    return build.library


def assert_clean(library: Library) -> None:
    assert [check.shortfalls for check in verify_library(library)] == [[]] * library.tap_error.size
