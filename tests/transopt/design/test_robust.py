"""Libraries robust against the uncertainty of their model, and libraries played on another device than their own."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import problems
from controller.sim.played_tap import play_tap
from controller.sim.simulated_tap import SimulatedTap
from controller.sim.simulator import Imperfections
from controller.sim.true_device import device_of
from tests.benches.commands import Run
from tests.benches.compiled import servo_of
from tests.benches.model_parts import (
    BOX,
    ON_FILE,
    POLE,
    ROBUST,
    SMALL,
    Make,
    Parts,
    amplifier_part,
    assert_clean,
    built,
    drive_device,
    fourth_order_hand,
    hand_part,
    solved,
    state_space_device,
)
from transopt.base.errors import InputError
from transopt.library.file import load_library
from transopt.library.library import Library
from transopt.recordings.recording import Recording
from transopt.report.markdown import build_markdown
from transopt.scene.identified import IdentifiedModel
from transopt.scene.scene import Scene


class TestRobust:
    def test_draws_are_one_set_of_devices_around_the_identified_one(self, make: Make) -> None:
        scene = make(ON_FILE, {"device": drive_device(0.1)}, more=ROBUST)
        assert isinstance(scene.model, IdentifiedModel)
        nominal = scene.model.moving.values()
        for grip in (1.0, 5.0):
            drawn = [(of.model, at) for of, at in scene.spread(grip)]
            assert [at for _, at in drawn] == [grip] * 4
            values = np.array([model.moving.values() for model, _ in drawn])
            assert np.allclose(values.mean(axis=0), nominal, rtol=1e-12)
            assert np.abs(values / nominal - 1).max() > 0.05
            if grip == 1.0:
                first = values
            assert np.array_equal(values, first)

    def test_draws_have_the_spread_of_the_covariance(self, make: Make) -> None:
        model = make(ON_FILE, {"device": drive_device(0.02)}).model
        assert isinstance(model, IdentifiedModel)
        values = np.array([one.moving.values() for one in model.drawn(2001, [3.0])])
        relative = values / model.moving.values() - 1
        assert np.allclose(np.cov(relative.T), 0.02**2 * np.eye(relative.shape[1]), atol=0.15 * 0.02**2)

    def test_draws_that_are_not_passive_are_drawn_again(self, make: Make) -> None:
        model = make(ON_FILE, {"device": drive_device(0.5)}).model
        assert isinstance(model, IdentifiedModel)
        drawn = model.drawn(15, [1.0, 5.4])
        assert len(drawn) == 15
        for one in drawn:
            assert all(np.linalg.eigvals(one.plant(F, None).A).real.max() < 0 for F in (1.0, 5.4))
        # Taken as they come a third of such draws is no device at all.
        part, random = drive_device(0.5), np.random.default_rng(0)

        def take_fifty() -> None:
            for _ in range(50):
                part.with_values(part.values() + part.factor() @ random.standard_normal(len(part.parameters)))

        with pytest.raises(InputError, match=r"greater than|passive|must be > 0"):
            take_fifty()

    @pytest.mark.parametrize("spread", ["", "grip_spread = 0.05\n"])
    def test_is_certified_and_better_over_the_spread(
        self, make: Make, taps: list[Recording], tmp_path: Path, spread: str
    ) -> None:
        parts: Parts = {"device": drive_device(0.15)}
        # Nine devices take as long at one grip as four at two.
        grips, devices = ("[3.0]", 8) if spread else ("[1.0, 5.0]", 4)
        build = built(make(ON_FILE, parts, SMALL, ("[1.0, 3.0, 5.0]", grips), more=ROBUST + spread), taps)
        assert build.library.spread_A.shape == (1 if spread else 2, devices, 6, 6)
        for entry in build.all_entries():
            assert entry.certificate.accepted
            assert entry.spread.robust_rms <= entry.spread.nominal_rms * (1 + 1e-6)
        gains = [1 - e.spread.robust_rms / e.spread.nominal_rms for e in build.all_entries() if e.spread]
        assert max(gains) > 1e-3
        text = build_markdown(build, full=False)
        assert "4 devices drawn from the covariance" in text
        assert ("grips of +-5%" in text) is bool(spread)
        build.library.save(tmp_path / "library.npz")
        assert_clean(load_library(tmp_path / "library.npz"))

    def test_a_hand_has_its_uncertainty_too(self, make: Make) -> None:
        for hand in (hand_part(0.05), fourth_order_hand(0.05)):
            scene = make(ON_FILE, {"hand": hand}, more=ROBUST)
            assert len({scene_of_draw.plant(3.0).A[-1, -1] for scene_of_draw, _ in scene.spread(3.0)}) == 4


class TestPlayed:
    @pytest.fixture
    def own(self, make: Make, taps: list[Recording]) -> Library:
        parts: Parts = {"device": drive_device(), "amplifier": amplifier_part()}
        return solved(make(ON_FILE, parts, (POLE, ""), SMALL, ("[1.0, 3.0, 5.0]", "[3.0]")), taps)

    @pytest.fixture
    def box(self, make: Make, taps: list[Recording]) -> Library:
        parts: Parts = {"device": state_space_device(), "amplifier": amplifier_part()}
        return solved(make(BOX, parts, (POLE, ""), SMALL), taps)

    def test_on_its_own_device_and_on_another(self, own: Library, scene: Scene) -> None:
        def played(**on: Any) -> float:
            tap = SimulatedTap(0.4, 3.0, imperfections=Imperfections(mismatch=0.1), seed=4)
            return play_tap(own, servo_of(own, amplifier_tolerance=0.1), tap, **on).playback_error

        truth = device_of(scene)
        assert played(device=truth) == pytest.approx(played(), rel=1e-9)
        heavy = replace(
            truth, masses_kg=(truth.masses_kg[0], replace(truth.masses_kg[1], constant=0.05), truth.masses_kg[2])
        )
        assert played(device=heavy) > 2 * played()

    def test_from_the_command_line(self, play: Run, own: Library, box: Library, tmp_path: Path) -> None:
        own.save(tmp_path / "own.npz")
        box.save(tmp_path / "box.npz")
        alone = play("tap", "own.npz", "--simulate")
        on_another = play("tap", "own.npz", "--simulate", "--true-device", "library.npz")
        assert alone.code == on_another.code == 0, on_another.err
        assert "on the device of library.npz" in " ".join(on_another.out.split())
        copied = Path("copied.toml")
        copied.write_text(problems.scene_path("wood_on_foam").read_text())
        tables = [play("tap", "own.npz", "--simulate", "--true-device", name) for name in ("wood_on_foam", copied)]
        figures = [[line for line in table.out.splitlines() if "tap error" in line] for table in tables]
        assert figures[0] == figures[1]
        refused = play("tap", "box.npz", "--simulate")
        assert refused.code == 2
        assert "--true-device" in refused.err
        assert play("tap", "box.npz", "--simulate", "--true-device", "library.npz", "--grip", 2.2).code == 0
        assert play("tap", "own.npz", "--simulate", "--true-device", "none.toml").code == 2
        assert play("tap", "own.npz", "--port", "x", "--true-device", "library.npz").code == 2
