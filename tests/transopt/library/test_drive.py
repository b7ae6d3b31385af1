"""Files for a driver and the C header of named targets: what leaves, and what a program reads of it."""

import csv
import re
import shutil
import struct
import subprocess
import wave
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import signal
from scipy.io import wavfile

from tests.benches.actuators import clicks
from transopt.base.errors import InputError
from transopt.library.drive import Driver, chosen, drive_of, driver_for, held
from transopt.library.drive_files import export_drive, file_names
from transopt.library.drive_replay import played
from transopt.library.export import export_library
from transopt.library.library import Library
from transopt.plant.amplifier import Amplifier
from transopt.plant.discretise import discretise
from transopt.problem.limits.limit import tolerated

RATE_HZ = 48000.0  # of the design
COUNTS = {"8": 127, "16": 32767, "24": 2**23 - 1, "32": 2**31 - 1}


@pytest.fixture(scope="module")
def lra() -> Library:
    return clicks()


def left(library: Library, iv: int = 0, **driver: float | str) -> np.ndarray:
    """Values as one entry leaves, [V]."""
    return drive_of(library, iv, 0, driver_for(library, **driver)).values  # type: ignore[arg-type]


# --- resampling ----------------------------------------------------------------------------------------------


class TestHeld:
    @pytest.mark.parametrize("repeats", [1, 2, 5])
    def test_a_multiple_of_the_rate_repeats_the_command(self, repeats: int) -> None:
        command = np.random.default_rng(1).uniform(-1, 1, 40)
        np.testing.assert_array_equal(held(command, float(repeats)), np.repeat(command, repeats))

    def test_a_divisor_of_the_rate_is_the_mean_of_whole_periods(self) -> None:
        command = np.random.default_rng(1).uniform(-1, 1, 40)
        np.testing.assert_allclose(held(command, 1 / 4), command.reshape(-1, 4).mean(axis=1), rtol=1e-12)

    @pytest.mark.parametrize(("up", "down"), [(147, 160), (3, 7), (13, 11)])
    def test_any_ratio_is_the_mean_over_the_drivers_period(self, up: int, down: int) -> None:
        command = np.random.default_rng(2).uniform(-1, 1, 61)
        fine = np.repeat(command, up)  # on the grid that both rates share
        padded = np.append(fine, np.zeros(-fine.size % down))
        found = held(command, up / down)
        np.testing.assert_allclose(found, padded.reshape(-1, down).mean(axis=1), atol=1e-12)
        assert np.abs(found).max() <= (1 + 1e-12) * np.abs(command).max()

    def test_no_held_waveform_is_nearer(self) -> None:
        command = np.random.default_rng(3).uniform(-1, 1, 160)
        found, fine = held(command, 147 / 160), np.repeat(command, 147)

        def distance(samples: np.ndarray) -> float:
            return float(np.linalg.norm(np.repeat(samples, 160) - fine))

        for j in range(0, found.size, 10):
            for step in (-1e-3, 1e-3):
                assert distance(found + step * np.eye(found.size)[j]) > distance(found)

    def test_a_rate_that_drifts_by_part_of_a_sample_is_no_multiple(self) -> None:
        command = np.append(np.zeros(999), 1.0)
        assert held(command, 1.0 + 1e-4).size == 1001
        assert held(command, 1.0 + 1e-10).size == 1000


# --- counts --------------------------------------------------------------------------------------------------


class TestSamples:
    @pytest.mark.parametrize("bits", COUNTS)
    def test_counts_are_half_a_count_from_the_command(self, lra: Library, bits: str) -> None:
        drive = drive_of(lra, 0, 0, driver_for(lra, bits=bits))
        scale = 3.0 / COUNTS[bits]
        assert drive.driver.scale == pytest.approx(scale, rel=1e-12)
        assert np.abs(drive.values - lra.command[0, 0]).max() <= scale / 2 + tolerated(3.0)
        assert np.abs(drive.samples).max() == COUNTS[bits]  # the click needs all of it
        assert drive.saturated == 0

    def test_float_is_a_share_of_full_scale(self, lra: Library) -> None:
        drive = drive_of(lra, 0, 0, driver_for(lra, bits="float", full_scale=6.0))
        assert drive.samples.dtype == np.float32
        np.testing.assert_allclose(drive.samples, lra.command[0, 0] / 6.0, atol=1e-7)

    @pytest.mark.parametrize("bits", [*COUNTS, "float"])
    def test_what_is_beyond_full_scale_is_clipped_and_counted(self, lra: Library, bits: str) -> None:
        drive = drive_of(lra, 0, 0, driver_for(lra, bits=bits, full_scale=1.0))
        beyond = int((np.abs(lra.command[0, 0]) > 1.0 + (0.5 / 127 if bits == "8" else 1e-4)).sum())
        assert drive.saturated > 100
        assert abs(drive.saturated - beyond) <= 2
        assert drive.peak == pytest.approx(1.0, rel=1e-6)

    def test_full_scale_is_the_range_of_the_command(self, lra: Library, library: Library) -> None:
        assert driver_for(lra).full_scale == pytest.approx(3.0)
        assert driver_for(lra).unit == "V"
        # An amplifier with a pole is commanded beyond the limit of the current.
        assert driver_for(library).full_scale == pytest.approx(6.0)
        assert driver_for(library).unit == "A"

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            ({"rate_Hz": 50.0}, ("rate 50 Hz", "100 to 1e+06 Hz", "--rate-Hz", "48000")),
            ({"rate_Hz": float("nan")}, ("rate nan Hz", "100 to 1e+06 Hz")),
            ({"full_scale": 0.0}, ("full scale 0 V", "> 0", "--full-scale it is 3 V")),
            ({"full_scale": float("inf")}, ("full scale inf V", "finite")),
            ({"bits": "12"}, ("'12'", "8, 16, 24, 32, float")),
        ],
    )
    def test_refusals(self, lra: Library, options: dict[str, float | str], words: tuple[str, ...]) -> None:
        with pytest.raises(InputError) as caught:
            driver_for(lra, **options)  # type: ignore[arg-type]
        assert "\n" not in str(caught.value)
        assert all(word in str(caught.value) for word in words)


class TestChosen:
    def test_all_or_one_target(self, lra: Library) -> None:
        assert chosen(lra) == [(0, 0), (1, 0)]
        assert chosen(lra, target="tick, soft") == [(1, 0)]

    def test_nodes_of_a_grid(self, library: Library) -> None:
        grid = [(iv, ig) for iv in range(4) for ig in range(3)]
        assert chosen(library) == grid
        assert chosen(library, speed_m_s=0.2) == [(1, 0), (1, 1), (1, 2)]
        assert chosen(library, speed_m_s=0.2, grip_N=5.0) == [(1, 2)]

    def test_refusals(self, lra: Library, library: Library) -> None:
        with pytest.raises(InputError, match=r"--target 'clik': .* choose one of click 150 Hz, tick, soft"):
            chosen(lra, target="clik")
        with pytest.raises(InputError, match="--speed: this library has targets; choose with --target"):
            chosen(lra, speed_m_s=0.2)
        with pytest.raises(InputError, match=r"--target: this library has no targets .* --speed and --grip"):
            chosen(library, target="click")
        with pytest.raises(InputError, match=r"--grip 2 N: not on the library's grid; choose one of 1, 3, 5 N"):
            chosen(library, grip_N=2.0)


# --- the replay ----------------------------------------------------------------------------------------------


class TestPlayed:
    def test_at_the_designs_rate_it_is_the_design(self, lra: Library) -> None:
        driver = driver_for(lra, bits="32")
        found = played(lra, [drive_of(lra, iv, 0, driver) for iv in (0, 1)])
        for iv, each in enumerate(found):
            assert each.tap_error == pytest.approx(lra.tap_error[iv, 0], rel=1e-6)
            assert each.error_after == pytest.approx(lra.error_after[iv, 0], rel=1e-4)
            assert each.tap_error_designed == pytest.approx(lra.tap_error[iv, 0], rel=1e-12)
            assert each.limits_left == ()
            scale = np.abs(lra.acceleration_m_s2[iv, 0]).max()
            predicted, _ = lra.lasting(iv, 0)
            np.testing.assert_allclose(each.acceleration_m_s2, predicted, atol=1e-6 * scale)

    @pytest.mark.parametrize("rate_Hz", [44100.0, 32000.0, 144000.0])
    def test_another_rate_is_held_exactly(self, lra: Library, rate_Hz: float) -> None:
        """Against a step so fine that both rates fall on it."""
        drive = drive_of(lra, 0, 0, driver_for(lra, rate_Hz=rate_Hz, bits="16"))
        (found,) = played(lra, [drive])
        fine_Hz = np.lcm(int(rate_Hz), int(RATE_HZ))
        stage = discretise(lra.plant(0), lra.amplifier(), 1 / fine_Hz)
        output = np.append(drive.values, np.zeros(int(0.031 * rate_Hz)))
        fine, _ = stage.rollout(np.repeat(output, round(fine_Hz / rate_Hz)))
        wanted = fine[:: round(fine_Hz / RATE_HZ)][: found.acceleration_m_s2.size]
        np.testing.assert_allclose(found.acceleration_m_s2, wanted, atol=1e-9 * np.abs(wanted).max())

    def test_an_amplifier_with_pole_and_delay_is_in_it(self, library: Library) -> None:
        amplifier = library.amplifier()
        assert isinstance(amplifier, Amplifier)
        assert amplifier.delay_s > 0
        drive = drive_of(library, 3, 2, driver_for(library, rate_Hz=50000.0, bits="32"))
        (found,) = played(library, [drive])
        assert found.tap_error == pytest.approx(library.tap_error[3, 2], rel=1e-6)
        assert found.error_after == pytest.approx(library.error_after[3, 2], rel=1e-4)
        assert found.limits_left == ()

    def test_eight_bits_and_a_slow_driver_cost_and_clipping_costs_more(self, lra: Library) -> None:
        def nrmse(**driver: float | str) -> float:
            (found,) = played(lra, [drive_of(lra, 1, 0, driver_for(lra, **driver))])  # type: ignore[arg-type]
            return found.tap_error

        design = float(lra.tap_error[1, 0])
        assert abs(nrmse(bits="16") - design) < 1e-5
        assert abs(nrmse(bits="8") - design) < 1e-2
        assert nrmse(rate_Hz=1000.0) > design + 0.01
        assert nrmse(full_scale=1.0) > nrmse(rate_Hz=8000.0) + 0.05

    def test_a_polyphase_low_pass_would_be_clipped_and_farther(self, lra: Library) -> None:
        """Why it is the mean: the usual way of changing a rate, clipped to the driver's range, at 8 kHz."""
        driver = driver_for(lra, rate_Hz=8000.0, bits="float")
        pause = np.zeros(480)
        stretch = signal.resample_poly(np.concatenate([pause, lra.command[0, 0], pause]), 1, 6)
        samples, saturated = driver.samples(stretch[80:-80])
        mean = drive_of(lra, 0, 0, driver)
        assert (mean.saturated, mean.samples.size) == (0, samples.size)
        assert saturated > 0
        found, usual = played(lra, [mean, replace(mean, samples=samples)])
        assert found.tap_error < usual.tap_error

    @pytest.mark.parametrize("bits", ["8", "16"])
    def test_rounding_alone_leaves_no_limit(self, lra: Library, bits: str) -> None:
        scale = 3.0 / 40.6 if bits == "8" else 3.0 / 10000.6  # the limit is rounded up to a count
        driver = driver_for(lra, bits=bits, full_scale=scale * COUNTS[bits])
        drive = drive_of(lra, 0, 0, driver)
        assert drive.peak > 3.0 + scale / 3
        (found,) = played(lra, [drive])
        assert found.limits_left == ()

    def test_a_limit_that_the_samples_leave_is_said(self, lra: Library) -> None:
        drive = drive_of(lra, 0, 0, driver_for(lra))
        louder = replace(drive, driver=Driver(drive.driver.rate_Hz, drive.driver.depth, 12.0, "V"))
        (found,) = played(lra, [louder])
        voltage, stroke = found.limits_left
        assert re.fullmatch(r"replayed voltage 12\.0+ V, limit 3 V", voltage)
        assert re.fullmatch(r"replayed stroke 0\.00\d+ m, limit 0\.0006 m", stroke)


# --- files ---------------------------------------------------------------------------------------------------


class TestFiles:
    @pytest.mark.parametrize("bits", [*COUNTS, "float"])
    def test_wav_reads_back(self, lra: Library, tmp_path: Path, bits: str) -> None:
        files, found = export_drive(lra, tmp_path / "d.wav", bits=bits, target="click 150 Hz", rate_Hz=24000.0)
        assert files == [tmp_path / "d.wav"]
        samples = found[0].drive.samples
        if bits == "24":
            with wave.open(str(files[0])) as file:
                assert (file.getnchannels(), file.getsampwidth(), file.getframerate()) == (1, 3, 24000)
                frames = np.frombuffer(file.readframes(file.getnframes()), np.uint8).reshape(-1, 3)
            read = np.array([int.from_bytes(frame.tobytes(), "little", signed=True) for frame in frames])
        else:
            rate, read = wavfile.read(files[0])
            assert rate == 24000
            if bits == "8":
                read = read.astype(int) - 128
        np.testing.assert_array_equal(read, samples)
        assert samples.size == 480
        np.testing.assert_allclose(found[0].drive.values, left(lra, rate_Hz=24000.0, bits=bits), rtol=1e-12)

    @pytest.mark.parametrize(("bits", "code"), [("8", "b"), ("16", "<h"), ("32", "<i"), ("float", "<f")])
    def test_raw_samples_are_little_endian(self, lra: Library, tmp_path: Path, bits: str, code: str) -> None:
        (path,), (found,) = export_drive(lra, tmp_path / "d.bin", bits=bits, target="tick, soft")
        read = [value for (value,) in struct.iter_unpack(code, path.read_bytes())]
        np.testing.assert_array_equal(read, found.drive.samples)

    def test_raw_24_bit_have_three_bytes(self, lra: Library, tmp_path: Path) -> None:
        (path,), (found,) = export_drive(lra, tmp_path / "d.bin", bits="24", target="tick, soft")
        data = path.read_bytes()
        read = [int.from_bytes(data[j : j + 3], "little", signed=True) for j in range(0, len(data), 3)]
        np.testing.assert_array_equal(read, found.drive.samples)

    def test_one_file_an_entry(self, lra: Library, library: Library, tmp_path: Path) -> None:
        files, found = export_drive(lra, tmp_path / "phone.WAV")
        assert [file.name for file in files] == ["phone_click_150_Hz.WAV", "phone_tick_soft.WAV"]
        assert [each.drive.name for each in found] == ["click 150 Hz", "tick, soft"]
        files, _ = export_drive(library, tmp_path / "tap.bin", speed_m_s=0.2)
        assert [file.name for file in files] == [f"tap_0.2_m_s_{grip}_N.bin" for grip in (1, 3, 5)]
        assert all(file.is_file() for file in files)

    def test_names_differ_on_every_file_system(self) -> None:
        assert file_names(["a b", "A.b", "a, b", "A_B", "..", "é", "x" * 100]) == [
            "a_b",
            "A.b",
            "a_b_2",
            "A_B_3",
            "target",
            "target_2",
            "x" * 60,
        ]

    def test_npz_holds_all(self, lra: Library, tmp_path: Path) -> None:
        (path,), found = export_drive(lra, tmp_path / "d.npz", bits="8", rate_Hz=8000.0)
        with np.load(path, allow_pickle=False) as file:
            np.testing.assert_array_equal(file["samples"], [each.drive.samples for each in found])
            assert file["samples"].dtype == np.int8
            assert file["names"].tolist() == ["click 150 Hz", "tick, soft"]
            assert (str(file["unit"]), int(file["bits"])) == ("V", 8)
            assert [float(file[name]) for name in ("rate_Hz", "full_scale", "scale")] == pytest.approx(
                [8000.0, 3.0, 3.0 / 127]
            )
            assert str(file["content_sha256"]) == lra.content_sha256

    def test_csv_reads_back(self, lra: Library, library: Library, tmp_path: Path) -> None:
        (path,), found = export_drive(lra, tmp_path / "d.csv", rate_Hz=16000.0)
        comments, rows = _table(path)
        assert lra.content_sha256 in comments[0]
        assert list(rows[0]) == ["target", "k", "time_s", "sample", "command_V"]
        for each in found:
            own = [row for row in rows if row["target"] == each.drive.name]
            np.testing.assert_array_equal([int(row["sample"]) for row in own], each.drive.samples)
            np.testing.assert_array_equal([float(row["command_V"]) for row in own], each.drive.values)
            np.testing.assert_allclose([float(row["time_s"]) for row in own], np.arange(320) / 16000.0, atol=1e-15)
        export_drive(library, path, speed_m_s=0.4, grip_N=5.0)
        _, rows = _table(path)
        assert list(rows[0]) == ["speed_m_s", "grip_N", "k", "time_s", "sample", "command_A"]
        assert float(rows[0]["time_s"]) == pytest.approx(-library.lead_s)

    def test_a_rate_that_wav_cannot_state(self, lra: Library, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"rate 44099\.9 Hz: WAV states whole numbers; give --rate-Hz 44100"):
            export_drive(lra, tmp_path / "d.wav", rate_Hz=44099.9)
        export_drive(lra, tmp_path / "d.bin", rate_Hz=44099.9)

    @pytest.mark.parametrize("name", ["d.mat", "d", "d.pdf"])
    def test_an_unknown_suffix(self, lra: Library, tmp_path: Path, name: str) -> None:
        with pytest.raises(InputError) as caught:
            export_drive(lra, tmp_path / name)
        assert all(suffix in str(caught.value) for suffix in (name, ".wav", ".bin", ".npz", ".csv", ".h"))
        assert not list(tmp_path.iterdir())

    @pytest.mark.parametrize(("name", "whose"), [("d.ahap", "AHAP"), ("d.PWLE", "PWLE"), ("d.json", "AHAP")])
    def test_descriptions_of_phones_are_refused_by_name(
        self, lra: Library, tmp_path: Path, name: str, whose: str
    ) -> None:
        for write in (export_drive, export_library):
            with pytest.raises(InputError) as caught:
                write(lra, tmp_path / name)
            message = str(caught.value)
            assert "\n" not in message
            assert all(word in message for word in (name, whose, "cannot be written", "--drive", ".wav"))
        assert not list(tmp_path.iterdir())


def _table(path: Path) -> tuple[list[str], list[dict[str, str]]]:
    lines = path.read_text().splitlines()
    comments = [line for line in lines if line.startswith("# ")]
    return comments, list(csv.DictReader(lines[len(comments) :]))


# --- the formats that hold a whole library ----------------------------------------------------------------------


class TestWholeLibrary:
    def test_csv_has_names_and_volts(self, lra: Library, tmp_path: Path) -> None:
        export_library(lra, tmp_path / "d.csv")
        comments, rows = _table(tmp_path / "d.csv")
        assert comments[1] == "# SI units; the target begins at time 0"
        assert list(rows[0])[:2] == ["target", "k"]
        own = [row for row in rows if row["target"] == "tick, soft"]
        np.testing.assert_array_equal([float(row["command_V"]) for row in own], lra.command[1, 0])
        np.testing.assert_array_equal([float(row["voltage_V"]) for row in own], lra.plant_input[1, 0])


PROGRAM = """\
#include "clicks.h"
#include "clicks.h"
#include <stdio.h>
int main(void)
{
    int32_t j, k;
    for (j = 0; j < TRANSOPT_DRIVES; ++j) {
        const struct transopt_drive *drive = &transopt_drives[j];
        printf("%s\\n%.9g %.9g\\n", drive->name, (double)drive->rate_Hz, (double)drive->scale_V);
        for (k = 0; k < drive->length; ++k) printf("%d ", (int)drive->samples[k]);
        printf("\\n");
    }
    return (int)(sizeof transopt_drive_click_150_Hz[0]);
}
"""
COMPILERS = {"gcc": ["-std=c99", "-x", "c"], "g++": ["-std=c++11", "-x", "c++"]}
WARNINGS = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"]


class TestHeader:
    @pytest.mark.parametrize("compiler", COMPILERS)
    @pytest.mark.parametrize("bits", ["8", "16"])
    def test_a_program_reads_what_left(self, lra: Library, tmp_path: Path, bits: str, compiler: str) -> None:
        if shutil.which(compiler) is None:
            pytest.skip(f"no {compiler} on this machine")
        _, found = export_drive(lra, tmp_path / "clicks.h", bits=bits, rate_Hz=8000.0)
        (tmp_path / "main.c").write_text(PROGRAM)
        words = [compiler, *WARNINGS, *COMPILERS[compiler], "main.c", "-o", "program"]
        built = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert built.returncode == 0, built.stderr
        ran = subprocess.run([tmp_path / "program"], capture_output=True, text=True, check=False)
        assert ran.returncode == int(bits) // 8
        lines = ran.stdout.splitlines()
        assert lines[::3] == ["click 150 Hz", "tick, soft"]
        for each, numbers, samples in zip(found, lines[1::3], lines[2::3], strict=True):
            assert list(map(float, numbers.split())) == pytest.approx([8000.0, each.drive.driver.scale], rel=1e-6)
            np.testing.assert_array_equal(list(map(int, samples.split())), each.drive.samples)

    @pytest.mark.parametrize("bits", ["24", "32", "float"])
    def test_other_depths_are_refused(self, lra: Library, tmp_path: Path, bits: str) -> None:
        with pytest.raises(InputError, match=r"--bits: .* give --bits 8 or --bits 16"):
            export_drive(lra, tmp_path / "d.h", bits=bits)

    def test_taps_that_a_header_blends_are_refused(self, library: Library, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"speeds and grips, .* leave --drive out"):
            export_drive(library, tmp_path / "d.h")
        assert not list(tmp_path.iterdir())
