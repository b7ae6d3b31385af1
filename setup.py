"""The compiled parts: the solver's interior point, recursions, the device's core. All else stands in pyproject.toml.

All are plain C libraries that Python loads with ctypes: they use nothing of Python's binary interface. One wheel per
platform therefore serves every Python 3, and the files have a name without a version in it. All are optional: without
a C compiler the install succeeds, CasADi's solvers and BLAS take over, and a simulated device says what it lacks.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from setuptools import Extension, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_ext import build_ext

FIRMWARE = Path("controller/firmware")
SOLVER = Path("transopt/solvers/native")
CORE = sorted(path.as_posix() for path in (FIRMWARE / "src/core").glob("*.c"))
DRIVEN = [(FIRMWARE / "replay" / name).as_posix() for name in ("td_probe.c", "td_replay.c")]
# By name: Windows exports nothing else, and elsewhere everything is exported.
SOLVER_CALLS = [
    *("tr_interface", "tr_workspace", "tr_solve", "tr_shortened_workspace", "tr_shortened", "tr_linear", "tr_prove"),
    *("tr_device_workspace", "tr_device_stages"),
]
RECURSION_CALLS = [
    *("tr_most_states", "tr_most_width", "tr_most_largest", "tr_most_few", "tr_most_dense"),
    *("tr_run", "tr_forwards", "tr_backwards", "tr_courses", "tr_largest", "tr_bilinear", "tr_square_means"),
    *("tr_heated", "tr_spline", "tr_spline_even", "tr_struck", "tr_walled"),
]
CORE_CALLS = [
    *("td_probe_device_size", "td_probe_decoder_size", "td_probe_start", "td_probe_step", "td_probe_decode"),
    *("td_probe_look", "td_probe_image", "td_probe_enabled", "td_probe_coil", "td_probe_heat"),
    *("td_device_state", "td_device_receive", "td_device_send"),
    *("td_replay_size", "td_replay_start", "td_replay_run", "td_replay_heat", "td_replay_coil"),
    *("td_decoder_start", "td_wire_encode", "td_sha256_of", "td_crc32"),
]


def flags(compiler: str, name: str) -> list[str]:
    """Of a kind of compiler, as setuptools calls it, for one of the parts.

    A contraction of a * b + c into one rounding would give other bits on other processors. That no floating-point
    exception traps lets the compiler choose between two results that it has computed side by side. Most Pythons ask
    for debug information, which takes a fifth of the time and makes the files several times as large.
    """
    if compiler == "msvc":
        return ["/O2", "/fp:precise", "/std:c11"]
    fast = ["-O2"] if name.endswith("_core") else ["-O3", "-fno-math-errno", "-fno-trapping-math"]
    return ["-std=c99", "-g0", "-ffp-contract=off", *fast]


class Build(build_ext):
    """Plain shared libraries instead of modules of one Python."""

    def build_extensions(self) -> None:
        one_by_one = self.compiler.compile

        def side_by_side(sources: Sequence[str], *arguments: Any, **named: Any) -> list[str]:
            """Object files of the sources, each compiled on a core of its own: the solver's take minutes."""
            with ThreadPoolExecutor(os.cpu_count()) as pool:
                objects = pool.map(lambda source: one_by_one([source], *arguments, **named), sources)
                return [name for each in objects for name in each]

        self.compiler.compile = side_by_side
        super().build_extensions()

    def build_extension(self, ext: Extension) -> None:
        ext.extra_compile_args = flags(self.compiler.compiler_type, ext.name)
        super().build_extension(ext)

    def get_ext_filename(self, fullname: str) -> str:
        return fullname.replace(".", os.sep) + (".pyd" if os.name == "nt" else ".so")

    def get_export_symbols(self, ext: Extension) -> list[str]:
        return ext.export_symbols  # and no PyInit

    def get_libraries(self, ext: Extension) -> list[str]:
        return ext.libraries  # and not Python's


class Wheel(bdist_wheel):
    """For every Python 3 of one platform."""

    def get_tag(self) -> tuple[str, str, str]:
        return "py3", "none", super().get_tag()[2]


if __name__ == "__main__":
    setup(
        ext_modules=[
            Extension(
                "transopt.solvers.native._riccati",
                sorted(path.as_posix() for path in SOLVER.glob("*.c")),
                depends=[path.as_posix() for path in SOLVER.glob("*.h")],
                export_symbols=SOLVER_CALLS,
                libraries=["m"] if os.name == "posix" else [],
                optional=True,
            ),
            Extension(
                "transopt.base.native._recursions",
                ["transopt/base/native/recursions.c"],
                export_symbols=RECURSION_CALLS,
                libraries=["m"] if os.name == "posix" else [],
                optional=True,
            ),
            Extension(
                "controller.firmware._core",
                [*CORE, *DRIVEN],
                include_dirs=[(FIRMWARE / "src/core").as_posix(), (FIRMWARE / "replay").as_posix()],
                export_symbols=CORE_CALLS,
                optional=True,
            ),
        ],
        cmdclass={"build_ext": Build, "bdist_wheel": Wheel},
    )
