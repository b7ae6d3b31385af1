"""Following a drift of the surface where the device refuses to move it."""

from types import SimpleNamespace

import pytest

from controller.cli.port import _follow
from controller.host.driver import RefusedError
from controller.host.surface import Drift
from controller.protocol.codes import Reason


def followed(drift: Drift, reason: Reason) -> float:
    """The surface of the recording, behind a device that refuses for this reason."""

    def surface(counts: float) -> None:
        assert counts == pytest.approx(1007.5)
        raise RefusedError(reason.value, reason)

    recorder = SimpleNamespace(surface_counts=1000.0)
    _follow(drift, SimpleNamespace(surface=surface), recorder, SimpleNamespace(), None)  # type: ignore[arg-type]
    return recorder.surface_counts


@pytest.fixture
def drift(monkeypatch: pytest.MonkeyPatch) -> Drift:
    monkeypatch.setattr(Drift, "moved", 7.5)
    return Drift(1e-4, 24.5e-6, 1000.0)


@pytest.mark.parametrize("reason", [Reason.WALL_PUSHES, Reason.STILL_PLAYING])
def test_a_surface_that_was_touched_meanwhile_stays_until_the_next_rest(drift: Drift, reason: Reason) -> None:
    assert (followed(drift, reason), drift.surface_counts) == (1000.0, 1000.0)


def test_any_other_refusal_is_told(drift: Drift) -> None:
    with pytest.raises(RefusedError, match="fault"):
        followed(drift, Reason.FAULT_LATCHED)
