"""From records to files, from files to figures; the display; what is remembered of test pulses."""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from scipy import integrate

from controller.cli.tables import check_table
from controller.device.device_file import Accelerometer
from controller.host.bringup import Result
from controller.host.monitor import Monitor, event_line
from controller.protocol.codes import LinkNotice
from controller.protocol.events import Changed, Happened, Logged, Samples
from controller.protocol.messages import Record
from controller.record.played import met_surface, played_tap, through_pole
from controller.record.recorder import AFTER_S, BEFORE_S, Contact, Recorder
from controller.servo.interface import Fault, Notice, State
from controller.servo.settings import Settings
from controller.sim.sensors import SEED_SENSORS
from controller.waveforms.prediction import predict
from tests.benches.telemetry_file import read_csv
from transopt.base.errors import InputError
from transopt.library.library import Library
from transopt.recordings.recording import load_recording

DT_S, COUNT_M = 1e-4, 24.5e-6
CONTACT_TICK = 3000
ACCELEROMETER = Accelerometer(bandwidth_Hz=SEED_SENSORS.accelerometer_bandwidth_Hz)


def record(tick: int) -> Record:
    """Coming in at 0.2 m/s; the acceleration counts the ticks."""
    z_m = -0.2 * (tick - CONTACT_TICK) * DT_S
    return Record(round(z_m / COUNT_M), 3.0 + 1e-3 * (tick % 2), 0.5, tick * 1e-3, 0.0, 0.0, 0.0, 30.0, 1, 0)


def samples(first: int, last: int, missed: int = 0, every: int = 1) -> Samples:
    return Samples(first, every, tuple(record(tick) for tick in range(first, last, every)), missed)


def contact(tick: int = CONTACT_TICK) -> Happened:
    return Happened(1, tick, Notice.CONTACT, 0.2, 3.1, 0)


def fed(recorder: Recorder, last: int, step: int = 29) -> None:
    for first in range(0, last, step):
        recorder.take(samples(first, min(first + step, last)))


def test_a_contact_told_before_its_records_is_recorded_from_the_new_stream(tmp_path: Path) -> None:
    """A device that keeps the records of a tap tells the contact first; before, a few records show the hand."""
    first, end = CONTACT_TICK - round(BEFORE_S / DT_S), CONTACT_TICK + round(AFTER_S / DT_S) + 1
    with Recorder(tmp_path / "out", DT_S, COUNT_M) as recorder:
        recorder.take(samples(0, first + 100, every=200))
        recorder.take(contact())
        recorder.take(samples(first, end))
        recorder.take(samples(end + 50, end + 900, every=200))
    (found,) = recorder.contacts
    assert found.missed == 0
    assert found.ticks.tolist() == list(range(first, end))


def test_a_contact_whose_records_did_not_come_is_never_made_of_later_ones(tmp_path: Path) -> None:
    with Recorder(tmp_path / "out", DT_S, COUNT_M) as recorder:
        recorder.take(samples(0, CONTACT_TICK + 10))
        recorder.take(contact())
        recorder.take(samples(CONTACT_TICK + 100, CONTACT_TICK + 9000, every=200))
    (found,) = recorder.contacts
    assert found.missed == round(AFTER_S / DT_S) + 1 - 10
    assert found.path is None


@pytest.mark.parametrize(("most", "before", "after"), [(10_000, 600, 1000), (1601, 600, 1000), (800, 299, 499)])
def test_less_is_recorded_around_a_contact_where_less_is_kept(most: int, before: int, after: int) -> None:
    assert Recorder(None, DT_S, COUNT_M).fit(most) == (before, after)
    assert before + 1 + after <= most


def test_a_contact_becomes_a_file_when_its_time_has_passed(tmp_path: Path) -> None:
    end = CONTACT_TICK + round(AFTER_S / DT_S)
    with Recorder(tmp_path / "out", DT_S, COUNT_M) as recorder:
        fed(recorder, CONTACT_TICK)
        recorder.take(contact())
        recorder.take(samples(CONTACT_TICK, end))
        assert not recorder.contacts
        recorder.take(samples(end, end + 10))
        assert len(recorder.contacts) == 1
        # At once, not at the end of the run.
        recording = load_recording(tmp_path / "out" / "tap_001.csv")
    assert recording.speed_m_s == 0.2
    assert recording.grip_N == 3.1
    assert recording.acceleration.start_s == pytest.approx(-BEFORE_S)
    assert recording.acceleration.end_s == pytest.approx(AFTER_S)
    assert recording.acceleration.dt_s == pytest.approx(DT_S)
    assert recording.acceleration.values[0] == pytest.approx((CONTACT_TICK - 600) * 1e-3, rel=1e-5)
    assert recording.position.values[600] == pytest.approx(0.0, abs=COUNT_M / 2)
    assert recording.position.values[0] == pytest.approx(0.2 * BEFORE_S, abs=COUNT_M)
    assert (recording.current.values == 0.5).all()
    table = read_csv(tmp_path / "out" / "telemetry.csv")
    assert (table["tick"] == np.arange(end + 10)).all()
    assert table["encoder_counts"][0] == record(0).encoder_counts
    assert set(table["state"]) == {"armed"}
    lines = (tmp_path / "out" / "events.csv").read_text().splitlines()
    assert lines == ["tick,time_s,event,speed_m_s,grip_N,scale,cooled", "3000,0.3,contact,0.2,3.1,nan,nan"]
    assert (
        recorder.in_words() == f"; {tmp_path}/out: telemetry.csv, telemetry.npz, events.csv, tap_001.csv, all whole"
    )


def test_an_event_may_come_before_or_after_its_records(tmp_path: Path) -> None:
    late, early = Recorder(None, DT_S, COUNT_M), Recorder(None, DT_S, COUNT_M)
    early.take(contact())
    fed(early, CONTACT_TICK + 1010)
    fed(late, CONTACT_TICK + 1005)
    late.take(contact())
    late.take(samples(CONTACT_TICK + 1005, CONTACT_TICK + 1010))
    assert (late.contacts[0].ticks == early.contacts[0].ticks).all()
    assert late.contacts[0].path is None


def test_lost_records_leave_no_file_and_are_told(tmp_path: Path) -> None:
    with Recorder(tmp_path / "out", DT_S, COUNT_M) as recorder:
        recorder.take(contact())
        fed(recorder, CONTACT_TICK + 50)
        recorder.take(samples(CONTACT_TICK + 70, CONTACT_TICK + 1010, missed=20))
        assert recorder.contacts[0].missed == 20
        assert recorder.missed == 20
    assert not list((tmp_path / "out").glob("tap_*"))
    assert "(1 taps, cut short or with records lost, have no file of their own)" in recorder.in_words()


@pytest.mark.parametrize("what", [Fault.EMERGENCY_STOP, LinkNotice.LEASE_LOST])
@pytest.mark.parametrize("finished", [False, True])
def test_a_tap_that_a_fault_cut_counts_no_more(
    tmp_path: Path, library: Library, stated: Settings, what: Fault | LinkNotice, finished: bool
) -> None:
    with Recorder(tmp_path / "out", DT_S, COUNT_M) as recorder:
        recorder.take(contact())
        if finished:
            recorder.take(Happened(2, CONTACT_TICK + 800, Notice.FINISHED, np.nan, np.nan, 0))
        recorder.take(Happened(3, CONTACT_TICK + 900, what, np.nan, np.nan, 0))
        fed(recorder, CONTACT_TICK + 1010)
        recorder.take(contact(2 * CONTACT_TICK))
        recorder.take(samples(CONTACT_TICK + 1010, 2 * CONTACT_TICK + 1010))
    why = played_tap(recorder.contacts[0], library, stated, 1.0, ACCELEROMETER).why
    assert (why == f"cut short: {what.value}") != finished
    assert (recorder.contacts[0].path is None) != finished
    assert recorder.contacts[1].path is not None


def test_a_contact_of_which_nothing_came_has_no_file(tmp_path: Path) -> None:
    with Recorder(tmp_path / "out", DT_S, COUNT_M) as recorder:
        fed(recorder, 1000)
        recorder.take(contact())
        recorder.take(samples(9000, 9100, missed=8000))
        assert recorder.contacts[0].missed == 1601
        assert recorder.contacts[0].path is None


def test_a_contact_soon_after_the_start_is_recorded_from_there(tmp_path: Path) -> None:
    with Recorder(tmp_path / "out", DT_S, COUNT_M) as recorder:
        recorder.take(contact())
        recorder.take(samples(CONTACT_TICK - 100, CONTACT_TICK + 1010))
        assert recorder.contacts[0].missed == 0
    recording = load_recording(tmp_path / "out" / "tap_001.csv")
    assert recording.acceleration.start_s == pytest.approx(-0.01)


def test_a_tap_without_its_whole_time_has_no_file_but_its_telemetry(tmp_path: Path) -> None:
    with Recorder(tmp_path / "out", DT_S, COUNT_M) as recorder:
        recorder.take(contact())
        fed(recorder, CONTACT_TICK + 500)
    assert not recorder.contacts
    assert read_csv(tmp_path / "out" / "telemetry.csv")["tick"].size == CONTACT_TICK + 500


@pytest.mark.parametrize("name", ["telemetry.csv", "events.csv", "tap_007.csv"])
def test_nothing_is_written_over(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("precious")
    with pytest.raises(InputError, match=rf"holds a recording already \({name}\); choose another folder"):
        Recorder(tmp_path, DT_S, COUNT_M)
    assert (tmp_path / name).read_text() == "precious"


def test_the_trigger_finds_the_rise_once_and_not_gravity() -> None:
    recorder = Recorder(None, DT_S, COUNT_M, trigger_m_s2=5.0)
    acceleration = np.full(12_000, 9.8)
    acceleration[4000:4020] += 30.0
    acceleration[4300:4310] += 30.0  # it rings
    acceleration[8000:8020] -= 30.0
    for tick, value in enumerate(acceleration):
        recorder.take(Samples(tick, 1, (replace(record(tick), acceleration_m_s2=value),), 0))
    assert [c.tick for c in recorder.contacts] == [4000, 8000]
    assert np.isnan(recorder.contacts[0].speed_m_s)
    assert recorder.contacts[0].grip_N == pytest.approx(3.0005, abs=1e-4)


def test_a_tap_that_begins_beyond_the_range_is_found_and_so_is_the_next() -> None:
    """A reading at the accelerometer's rail is no number, and no part of the running mean."""
    recorder = Recorder(None, DT_S, COUNT_M, trigger_m_s2=5.0)
    acceleration = np.full(12_000, 9.8)
    acceleration[4000:4020] = [np.nan] * 6 + [60.0] * 14
    acceleration[8000:8020] += 30.0
    acceleration[9500:9600] = np.nan  # a loose contact
    for tick, value in enumerate(acceleration):
        recorder.take(Samples(tick, 1, (replace(record(tick), acceleration_m_s2=value),), 0))
    assert [c.tick for c in recorder.contacts] == [4000, 8000]
    assert recorder.loudest_m_s2 == pytest.approx(60.0 - 9.8)


def test_a_tap_of_an_object_beyond_the_range_has_a_reason_and_no_file(tmp_path: Path) -> None:
    acceleration = np.full(12_000, 9.8)
    acceleration[4000:4020] = [np.nan] * 6 + [60.0] * 14
    acceleration[8000:8020] += np.linspace(40.0, 10.0, 20)
    with Recorder(tmp_path / "out", DT_S, COUNT_M, trigger_m_s2=5.0, accelerometer=ACCELEROMETER) as recorder:
        for tick, value in enumerate(acceleration):
            recorder.take(Samples(tick, 1, (replace(record(tick), acceleration_m_s2=value),), 0))
    assert recorder.at_rail == {1: "the accelerometer was at its rail at 0.0 ms: use one with a wider range"}
    assert sorted(path.name for path in (tmp_path / "out").glob("tap_*")) == ["tap_002.csv"]
    assert "with records lost" not in recorder.in_words()


# Figures.


def played(
    library: Library, settings: Settings, *, late_s: float = 0.0, size: float = 1.0, gain: float = 1.0
) -> Contact:
    """A contact that went as predicted, but for what is said, behind the accelerometer's pole and on 1 g."""
    speed, grip, phase = 0.3, 3.0, 0.37
    prediction = predict(library, speed, grip, gain)
    begin = settings.lead_s + phase * DT_S
    fine = np.arange(-0.06, 0.1, 1e-6)
    moved = size * np.interp(fine - begin - late_s, prediction.times_s, prediction.acceleration_m_s2, left=0, right=0)
    sensed = through_pole(moved, 1e-6, 2500.0)
    ticks = np.arange(-600, 1000)
    z = -speed * (ticks * DT_S - begin)
    return Contact(
        number=1,
        tick=CONTACT_TICK,
        speed_m_s=speed,
        grip_N=grip,
        dt_s=DT_S,
        ticks=CONTACT_TICK + ticks.astype(float),
        counts=np.round(z / settings.count_m),
        acceleration_m_s2=9.81 + np.interp(ticks * DT_S, fine, sensed),
        current_A=np.zeros(ticks.size),
        command_A=np.zeros(ticks.size),
        feedback_A=np.zeros(ticks.size),
        winding_C=np.full(ticks.size, 25.0),
        missed=0,
    )


@pytest.mark.parametrize("late_s", [0.0, 3e-4, -2e-4])
def test_latency_and_error_are_found(library: Library, stated: Settings, late_s: float) -> None:
    found = played_tap(played(library, stated, late_s=late_s), library, stated, 1.0, ACCELEROMETER).compared
    assert found.latency_s == pytest.approx(late_s, abs=5e-6)
    assert found.playback_error < 0.01
    assert found.peak_m_s2 == pytest.approx(found.predicted_peak_m_s2, rel=0.01)


def test_what_is_too_large_is_an_error_and_a_gain_is_none(library: Library, stated: Settings) -> None:
    def error(size: float, gain: float, stated_gain: float) -> float:
        contact = played(library, stated, size=size, gain=gain)
        return played_tap(contact, library, stated, stated_gain, ACCELEROMETER).compared.playback_error

    assert error(1.1, 1.0, 1.0) == pytest.approx(0.1, abs=0.01)
    assert error(1.0, 0.5, 0.5) < 0.01
    assert error(1.0, 0.5, 1.0) > 0.4


def test_another_accelerometer_looks_like_latency(library: Library, stated: Settings) -> None:
    """The lag of one pole, 64 us at 2.5 kHz, belongs to the sensor and not to the device."""
    found = played_tap(played(library, stated), library, stated, 1.0, Accelerometer(bandwidth_Hz=1e6)).compared
    assert found.latency_s == pytest.approx(1 / (2 * np.pi * 2500.0), abs=5e-6)


def test_where_there_is_nothing_to_compare(library: Library, stated: Settings) -> None:
    good = played(library, stated)
    cases = {
        "20 records were lost": (replace(good, missed=20), 1.0),
        "nothing is played at gain 0": (good, 0.0),
        "the library is silent there": (replace(good, grip_N=0.1), 1.0),
        "not all of it was recorded": (replace(good, counts=-good.counts), 1.0),
    }
    for why, (case, gain) in cases.items():
        found = played_tap(case, library, stated, gain, ACCELEROMETER)
        assert (found.why, found.verdict) == (why, why)
        assert np.isnan(found.compared.playback_error)
        assert np.isnan(found.compared.latency_s)
    fast, firm = (replace(good, **{name: 3 * getattr(good, name)}) for name in ("speed_m_s", "grip_N"))
    for beyond, unit in ((fast, "m/s"), (firm, "N")):
        found = played_tap(beyond, library, stated, 1.0, ACCELEROMETER)
        assert found.why.startswith("not judged: ")
        assert f" {unit} lies outside the library's " in found.verdict
        assert np.isnan(found.compared.tap_error)
        assert ("about 0.44 times what this speed asks for" in found.why) == (beyond is fast)
    slow = replace(good, speed_m_s=library.speeds_m_s[0] / 2)
    assert "about 2 times what this speed asks for" in played_tap(slow, library, stated, 1.0, ACCELEROMETER).why
    edge = replace(good, speed_m_s=library.speeds_m_s[-1] * 1.01, grip_N=library.grips_N[-1] + 0.05)
    assert "not judged" not in played_tap(edge, library, stated, 1.0, ACCELEROMETER).why
    sparse = replace(good, **{name: getattr(good, name)[::3] for name in ("ticks", "counts", "acceleration_m_s2")})
    assert played_tap(sparse, library, stated, 1.0, ACCELEROMETER).why == "telemetry of every tick is needed"


def test_only_a_reading_within_what_is_compared_hides_a_tap(library: Library, stated: Settings) -> None:
    good = played(library, stated)
    figures = played_tap(good, library, stated, 1.0, ACCELEROMETER).compared
    times_s = (good.ticks - good.tick) * DT_S

    def at(*instants_s: float) -> Contact:
        lost = np.isin(np.round(times_s / DT_S), np.round(np.array(instants_s) / DT_S))
        return replace(good, acceleration_m_s2=np.where(lost, np.nan, good.acceleration_m_s2))

    around = played_tap(at(-0.05, -0.019, 0.085), library, stated, 1.0, ACCELEROMETER)
    assert around.why == ""
    assert around.compared.playback_error == pytest.approx(figures.playback_error, abs=1e-4)
    within = played_tap(at(3.4e-3), library, stated, 1.0, ACCELEROMETER)
    assert within.why.startswith("the accelerometer was at its rail at 3.")
    assert np.isnan(within.compared.tap_error)


def test_contact_is_where_the_approach_leads(library: Library, stated: Settings) -> None:
    off = replace(stated, surface_counts=10.0)
    # 10 counts further out are met that much earlier.
    for settings, earlier_s in ((stated, 0.0), (off, 10 * stated.count_m / 0.3)):
        found = met_surface(played(library, stated), settings)
        assert found == pytest.approx((stated.lead_s + 0.37e-4 - earlier_s, 0.3), abs=5e-6, rel=2e-3)


def test_the_pole_against_an_integrator() -> None:
    u = np.array([0.0, 1.0, -2.0, 0.5, 0.5, 3.0])
    times = np.arange(6) * DT_S
    pole = 2 * np.pi * 2500.0
    true = integrate.solve_ivp(
        lambda t, x: pole * (np.interp(t, times, u) - x),
        (0, times[-1]),
        [0.0],
        t_eval=times,
        max_step=2e-6,
        rtol=1e-9,
    )
    assert through_pole(u, DT_S, 2500.0) == pytest.approx(true.y[0], abs=1e-5)


# Display.


def test_the_display_shows_the_latest_and_counts() -> None:
    times = iter(np.arange(0, 10, 0.04))
    text = io.StringIO()
    console = Console(file=text, force_terminal=True, width=100)
    with Monitor(console, "desk", DT_S, COUNT_M, clock=lambda: float(next(times))) as shown:
        shown.take(samples(0, 30, missed=4))
        shown.take(Changed(State.FAULT, Fault.GRIP_LOST))
        for number in range(10):
            shown.take(replace(contact(), number=number))
        shown.take(Happened(11, 40, Fault.GRIP_LOST, float("nan"), float("nan"), 0))
        shown.take(Logged("hello"))
        console.print(shown.table())
    screen = text.getvalue()
    for words in (
        "contacts",
        "10",
        "fault: the stylus was let go",
        "records lost",
        "device: hello",
        "winding",
        "30.0 °C",
    ):
        assert words in screen
    assert shown.faults == [Fault.GRIP_LOST]
    assert shown.events[Notice.CONTACT] == 10


def test_without_a_terminal_events_are_lines() -> None:
    text, lost = io.StringIO(), Happened(2, 9999, LinkNotice.LEASE_LOST, float("nan"), float("nan"), 0)
    with Monitor(Console(file=text, width=200), "desk", DT_S, COUNT_M) as shown:
        shown.take(samples(0, 30))
        shown.take(contact())
        shown.take(lost)
    assert text.getvalue().splitlines() == [event_line(contact(), DT_S), event_line(lost, DT_S)]
    assert event_line(lost, DT_S) == f"   0.9999 s  {LinkNotice.LEASE_LOST.value}"
    assert event_line(contact(), DT_S).endswith("(0.200 m/s, 3.10 N)")


def test_events_that_a_device_had_no_room_for_are_told_once() -> None:
    text = io.StringIO()
    with Monitor(Console(file=text, width=200), "desk", DT_S, COUNT_M) as shown:
        for number, lost in enumerate((0, 16, 16, 17)):
            shown.take(replace(contact(), number=number, lost=lost))
    told = [line.split()[0] for line in text.getvalue().splitlines() if "found no room in the device's queue" in line]
    assert told == ["16", "17"]


# What a test pulse was measured to do.


@pytest.mark.parametrize("width", [60, 80])
def test_narrow_terminals_keep_whole_readings_and_checks(width: int) -> None:
    text = io.StringIO()
    console = Console(file=text, width=width)
    shown = Monitor(console, "desk", DT_S, COUNT_M)
    console.print(shown.table())
    seen = "20.03 mm for 20 mm, 1.0015 times what was expected; at rest 0.0123456 m/s²"
    console.print(check_table([Result("accelerometer", "0 ± 0.50 m/s² at rest, within 10 %", seen, True)], "desk"))
    out = text.getvalue()
    assert max(map(len, out.splitlines())) <= width
    assert "…" not in out
    assert {"20.03", "1.0015", "0.0123456"} <= set(out.replace("│", " ").split())
