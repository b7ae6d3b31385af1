"""What the noise of records is made of is told by name, and a plain record has no such name."""

from collections.abc import Callable

import numpy as np
import pytest

from tests.benches.identification import AMPLIFIER, DT_S, Rig, mismatched, spoilt
from transopt.base.signals import FloatArray
from transopt.identify.device.findings import noise_findings
from transopt.identify.device.trials import sort_trials
from transopt.identify.findings import Finding

GRIPS_N = (1.0, 3.0)
Change = Callable[[FloatArray, FloatArray, np.random.Generator], FloatArray]


def found(change: Change, seed: int = 0) -> list[Finding]:
    """The findings on sweeps whose accelerations (n,) at times (n,) have been changed."""
    random, times_s = np.random.default_rng(seed), DT_S * np.arange(100_000)
    sweeps = Rig(mismatched(0.1, 8)).sweeps(GRIPS_N)
    runs = [spoilt(run, "acceleration", lambda x: change(times_s[: x.size], x, random)) for run in sweeps]
    return noise_findings(sort_trials(runs, [], AMPLIFIER, None).grips)


def hum(times: FloatArray, values: FloatArray, random: np.random.Generator) -> FloatArray:
    return values + 0.5 * np.sin(2 * np.pi * 60.0 * times + random.uniform(0, 6.28))


def tremor(times: FloatArray, values: FloatArray, random: np.random.Generator) -> FloatArray:
    lines = random.uniform(8, 12, 6)
    return values + 0.5 * np.sin(2 * np.pi * np.outer(times, lines) + random.uniform(0, 6.28, 6)).sum(axis=1)


def steps(times: FloatArray, values: FloatArray, random: np.random.Generator) -> FloatArray:
    return 1.0 * np.round(values)


@pytest.mark.parametrize(
    ("change", "where", "says"),
    [
        (hum, "mains hum", "multiples of 60 Hz"),
        (tremor, "hand tremor", "rest the forearm"),
        (steps, "converter steps", "steps of 1 m/s^2"),
    ],
)
def test_by_name_with_a_remedy(change: Change, where: str, says: str) -> None:
    [finding] = found(change)
    assert finding.where == where
    assert says in finding.text
    assert not finding.fatal


def test_a_plain_record_has_none() -> None:
    assert found(lambda times, values, random: values) == []
