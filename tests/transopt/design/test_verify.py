"""A library that is verified from its own arrays: whatever was changed in it is said of its entry."""

from dataclasses import replace

import numpy as np
import pytest

from tests.benches.libraries import part_of
from transopt.design.verify import verify_library
from transopt.library.library import Library
from transopt.problem.answer import OBJECTIVE_SCALE, Status
from transopt.solvers import prove


@pytest.fixture(scope="module")
def library(library: Library) -> Library:
    """Two speeds of the default grid."""
    return part_of(library, [0, 1], [0, 1, 2])


CLAIMS = ("duality_gap", "primal_violation")  # next to zero, so that a share of them is next to nothing


def test_a_library_verifies_from_its_file_alone(library: Library) -> None:
    checks = verify_library(library)
    assert len(checks) == 6
    assert all(not check.shortfalls for check in checks)


@pytest.mark.parametrize("field", ["tap_error", "error_after", "objective", "plant_input", *CLAIMS])
def test_what_does_not_follow_from_the_waveform(library: Library, field: str) -> None:
    changed = getattr(library, field).copy()
    changed[1, 2] = 1.01 * changed[1, 2] + (1e-3 if field in CLAIMS else 0.0)
    (failed,) = [check for check in verify_library(replace(library, **{field: changed})) if check.shortfalls]
    assert failed.cells == ["0.2", "5"]
    assert field in " ".join(failed.shortfalls), failed.shortfalls


def test_no_certificate_is_of_the_solvers_own_stage_data(library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    def asked(*_: object) -> None:
        raise AssertionError("a certificate from the stage data of the solver")

    monkeypatch.setattr(prove, "_side_by_side", asked)
    assert not any(entry.shortfalls for entry in verify_library(library))


@pytest.mark.parametrize("below", [0.02, 1e3, np.inf])
def test_a_bound_that_proves_nothing(library: Library, below: float) -> None:
    """A bound may say less than can be proven, but not less than what the entry was accepted by."""
    bound = library.lower_bound.copy()
    bound[1, 2] = library.objective[1, 2] - below * max(library.objective[1, 2], OBJECTIVE_SCALE)
    checks = verify_library(replace(library, lower_bound=bound))
    (failed,) = [check for check in checks if check.shortfalls]
    assert failed.cells == ["0.2", "5"]
    assert "which does not prove" in failed.shortfalls[0]
    bound[1, 2] = library.objective[1, 2] - 0.009 * max(library.objective[1, 2], OBJECTIVE_SCALE)
    assert not any(check.shortfalls for check in verify_library(replace(library, lower_bound=bound)))


def test_a_limit_that_is_said_to_bind(library: Library) -> None:
    binding = library.binding.astype("U200")
    binding[0, 0] = "current +4 A at 1.00 ms"
    assert "binding says" in verify_library(replace(library, binding=binding))[0].shortfalls[0]


def test_a_waveform_of_another_node(library: Library) -> None:
    swapped = library.command[::-1].copy()
    assert all(check.shortfalls for check in verify_library(replace(library, command=swapped)))


def test_a_status_that_is_not_optimal(library: Library) -> None:
    status = library.status.astype("U100")
    status[0, 0] = Status.ITERATION_LIMIT.value
    checks = verify_library(replace(library, status=status))
    assert "status in the file" in checks[0].shortfalls[0]
