"""The C header of named targets: a program that includes it reads what left."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests.benches.actuators import clicks
from transopt.base.errors import InputError
from transopt.library.drive_files import export_drive
from transopt.library.library import Library

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


@pytest.fixture(scope="module")
def lra() -> Library:
    return clicks()


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
