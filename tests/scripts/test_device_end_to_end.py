"""A tap on the compiled device, recorded and compared."""

from pathlib import Path

import pytest

from tests.benches.scripts import script
from transopt.library.library import Library

end_to_end = script("device_end_to_end")


@pytest.mark.usefixtures("c_compiler", "pseudo_terminal")
def test_a_tap_goes_over_the_line_into_a_file_and_agrees_with_its_prediction(
    library: Library, tmp_path: Path
) -> None:
    [condition] = end_to_end.recorded(library, [(0.3, 3.0)], end_to_end.IDEAL, 1, 0, tmp_path / "taps")
    assert condition.latency_rms_s < end_to_end.MOST_LATENCY_S
    assert condition.playback_errors[0] < 0.01
    # What the limits leave of it at this node is told apart from how well it is played.
    assert abs(condition.tap_error - library.tap_error[library.speeds_m_s == 0.3, library.grips_N == 3.0][0]) < 0.02
    assert condition.taps[0].contact.speed_m_s == pytest.approx(0.3, rel=0.05)
