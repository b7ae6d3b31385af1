"""Files as instruments write them: names, units, several taps in one, channels; and each refusal's own next step."""

from pathlib import Path

import numpy as np
import pytest

from tests.benches.recording_files import DT_S, TAP_M_S2, TIMES_S, load, mat, npz, refusal, text
from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2 as G
from transopt.files.names import apart, stated_units
from transopt.files.text_rows import cells_of, parted_text
from transopt.recordings.recording import VOCABULARY

IN_G = text(TIMES_S, TAP_M_S2 / G)
QUOTED = "".join('"{}","{}"\n'.format(*row.replace(".", ";").split(",")) for row in IN_G.split()).replace(";", ",")


# ---- names and units ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("header", "rows"),
    [
        ("time [s],a [g]", IN_G),
        ("Time (s) , Acceleration (g)", IN_G),
        ("t/s,acc/g", IN_G),
        ("in s,Acc in g", IN_G),
        ("# time(s), \t \t acceleration(g)", IN_G.replace(",", " ")),
        ("time (s)  acc (g)", IN_G.replace(",", " ")),
        ("Time [s]\tAccel [g]", IN_G.replace(",", "\t")),
        ("Zeit [s];Beschleunigung [g]", IN_G.replace(",", ";").replace(".", ",")),
        ("Time,Acc\n(s),(g)\n", IN_G),
        ("time (ms),acc (m/s²)", text(1e3 * TIMES_S, TAP_M_S2)),
        ("time [µs],acc [m/s^2]", text(1e6 * TIMES_S, TAP_M_S2)),
        ("time [s],acc [ft/s^2]", text(TIMES_S, TAP_M_S2 / 0.3048)),
        ("time [s],acc [gal]", text(TIMES_S, TAP_M_S2 / 0.01)),
        ("# speed_m_s: 0.2\ntime_s,acc [mg]", text(TIMES_S, 1e3 * TAP_M_S2 / G)),
    ],
)
@pytest.mark.parametrize("suffix", [".csv", ".txt", ".log"])
def test_headers_of_instruments(tmp_path: Path, header: str, rows: str, suffix: str) -> None:
    recording = load(tmp_path, f"{header}\n{rows}", suffix)
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-6)
    assert recording.acceleration.dt_s == pytest.approx(DT_S, rel=1e-9)


@pytest.mark.parametrize(
    "content",
    [
        "Sample rate: 10000 Hz\nDate: 05.03.2024\nOperator: lab\n\nTime (s),Acc (g)\n" + IN_G,
        "Logger,X7\nRange,16\nRate,10000\nspeed_m_s,0.3\nt [s],a [g]\n" + IN_G,
        "Logger;X7\nspeed_m_s;0,3;\nt [s];a [g]\n" + IN_G.replace(",", ";").replace(".", ","),
        "3 channels, 2 of them off\n\ntime,acc\n[s],[g]\n\n" + IN_G,
        "Scope\ntime,acc\nsec,M/S^2\n" + text(TIMES_S, TAP_M_S2),
        "* made by a simulator\n% and another\n// and a third\ntime_s acceleration_g\n" + IN_G.replace(",", " "),
        "Time [s]\tAcc [g]\n" + IN_G.replace(",", "\t").replace(".", ","),
        "2 Hz\nTime [s]\tAcc [g]\n" + IN_G.replace(",", "\t").replace(".", ","),
        '"Time (s)","Acc (g)"\n' + QUOTED,
    ],
)
def test_what_scopes_and_loggers_write_above_the_numbers(tmp_path: Path, content: str) -> None:
    recording = load(tmp_path, content)
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-9)
    assert recording.acceleration.dt_s == pytest.approx(DT_S, rel=1e-9)
    assert recording.speed_m_s == (0.3 if "speed_m_s" in content else None)


def test_a_comma_between_thousands_is_no_decimal_one(tmp_path: Path) -> None:
    rows = "".join(f'{t:.5f},"{a:,.3f}"\n' for t, a in zip(TIMES_S, 1e3 * TAP_M_S2 / G, strict=True))
    whole = "".join(f'{t:.5f},"{a:,.0f}"\n' for t, a in zip(TIMES_S, 1e6 * TAP_M_S2 / G, strict=True))
    for unit, cells in (("mg", rows), ("ug", whole)):
        recording = load(tmp_path, f"time [s],acc [{unit}]\n{cells}")
        np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-4)
    clock = "".join(
        '"12:00:{:07.4f}","{}"\n'.format(t, f"{a:.3f}".replace(".", ","))
        for t, a in zip(TIMES_S, TAP_M_S2, strict=True)
    )
    recording = load(tmp_path, f"time,acc [m/s^2]\n{clock}")  # a point in the time of day says nothing
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-3)
    rate = "Sample rate: 10,000 Hz\nacc [g]\n" + text(TAP_M_S2 / G)
    assert refusal(tmp_path, rate).startswith("0 time columns")


def test_points_between_thousands_beside_decimal_commas(tmp_path: Path) -> None:
    def german(value: float, places: int) -> str:
        return f"{value:,.{places}f}".translate(str.maketrans(",.", ".,"))

    head = "Zeit [s];Beschleunigung [ug]\n"
    rows = [f"{german(t, 5)};{german(a, 3)}" for t, a in zip(TIMES_S, 1e6 * TAP_M_S2 / G, strict=True)]
    recording = load(tmp_path, head + "\n".join(rows))
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-5)
    for cells in ([german(a, 0) for a in 1e6 * TAP_M_S2 / G], [f"{a:.3f}" for a in TAP_M_S2 / G]):
        rows = [f"{german(t, 5)};{cell}" for t, cell in zip(TIMES_S, cells, strict=True)]
        assert "stands beside decimal commas: is its point a decimal" in refusal(tmp_path, head + "\n".join(rows))


def test_channels_of_labview_have_their_units_and_their_own_times(tmp_path: Path) -> None:
    head = "Y_Unit_Label\tVolts\nDelta_X\t1.0E-4\n***End_of_Header***\nX_Value\tcDAQ1Mod1/ai0\tComment\n"
    rows = "".join(f"\t{a:.9f}\n" for a in 0.1 * TAP_M_S2 / G)
    assert refusal(tmp_path, head + rows, ".lvm").startswith("column 'cDAQ1Mod1/ai0 [Volts]' is what a sensor gives")
    recording = load(tmp_path, head + rows, ".lvm", units={"cDAQ1Mod1/ai0": "V @ 100 mV/g"})
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-6)


@pytest.mark.parametrize("encoding", ["cp1252", "cp850", "utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("head", ["Zeit [µs];Beschleunigung [m/s²]", "# Prüfer: Öhler\nZeit/µs;a/m/s²"])
def test_text_in_every_usual_encoding(tmp_path: Path, head: str, encoding: str) -> None:
    """A micro sign is a capital letter with an accent in the wrong code page, and no unit."""
    rows = text(1e6 * TIMES_S, TAP_M_S2, delimiter=";").replace(".", ",")
    recording = load(tmp_path, f"{head}\n{rows}".encode(encoding))
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-6)
    assert recording.acceleration.dt_s == pytest.approx(DT_S, rel=1e-9)


def test_a_hammers_text_needs_only_its_units(tmp_path: Path) -> None:
    content = "time force acc\n" + text(TIMES_S, TAP_M_S2, TAP_M_S2 / G, delimiter=" ")
    message = refusal(tmp_path, content, ".txt")
    assert message.startswith("no unit stated in the columns 'time, force, acc'; known: time in s, ms")
    proposed = message.split("--units '")[1].split("'")[0]
    assert proposed == "time=s,force=N,acceleration=m/s^2"
    recording = load(tmp_path, content, ".txt", units={**stated_units(proposed), "acc": "g"})
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-9)
    assert recording.force is not None


def test_columns_and_units_of_bare_numbers(tmp_path: Path) -> None:
    content = text(1e3 * TIMES_S, np.ones(TIMES_S.size), TAP_M_S2 / G)
    assert "has no row of names above it; state it, for example --columns" in refusal(tmp_path, content)
    recording = load(tmp_path, content, columns=["time", "-", "acc"], units={"time": "ms", "acc": "g"})
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-9)
    assert "state it" in refusal(tmp_path, content, columns=["time_ms", "-", "acc"])


@pytest.mark.parametrize("pack", [npz, mat])
def test_variables_that_are_given_units(tmp_path: Path, pack: object) -> None:
    suffix = ".npz" if pack is npz else ".mat"
    content = pack(t=1e3 * TIMES_S, acc=TAP_M_S2 / G, other=np.ones(3))  # type: ignore[operator]
    recording = load(tmp_path, content, suffix, units={"time": "ms", "acc": "g"})
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-9)
    said = refusal(tmp_path, content, suffix)
    assert said.startswith("no unit stated in the columns 't, acc'; known: time in s, ms")
    assert "state it, for example --units 'time=ms,acceleration=m/s^2' (in a scene recordings.units = " in said
    # Times without a unit are asked about, not passed over, where the acceleration has one.
    assert refusal(tmp_path, pack(t=TIMES_S, acc_g=TAP_M_S2), suffix).startswith("no unit stated in the column 't'")  # type: ignore[operator]


def test_the_unit_of_a_structure_is_that_of_its_acceleration(tmp_path: Path) -> None:
    content = mat(rec={"time": TIMES_S, "acc": TAP_M_S2 / G, "unit": "g", "fs": 1e4})
    assert refusal(tmp_path, content, ".mat").startswith("no unit stated in the column 'time'")
    recording = load(tmp_path, content, ".mat", units={"time": "s"})
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-9)


def test_axes_are_called_as_the_file_has_them(tmp_path: Path) -> None:
    content = "time [s],x,y,z\n" + text(TIMES_S, 0 * TIMES_S, 0 * TIMES_S, TAP_M_S2 / G)
    recording = load(tmp_path, content, units={"x": "g", "y": "g", "z": "g"})
    assert np.ptp(recording.acceleration.values) == pytest.approx(np.ptp(TAP_M_S2), rel=1e-6)
    assert refusal(tmp_path, content, units={"w": "g"}).startswith("--units w: no column of that name")


@pytest.mark.parametrize(
    ("header", "options", "words"),
    [
        ("time [s],a [furlong]", {}, "column 'a [furlong]': 'furlong' is no unit of acceleration; known: m/s^2"),
        ("time [s],acc [mV]", {}, "column 'acc [mV]': 'mV' is no unit of acceleration without the sens"),
        ("time [s],a [mV]", {}, "column 'a [mV]' is what a sensor gives, and its sensitivity is not stated"),
        ("time [s],Temp [C]", {}, "unknown column 'Temp [C]'; known: time_s"),
        ("time [s],a [g]", {"units": {"accel": "g"}}, "--units accel: no column of that name; the file has"),
        ("time [s],acc", {"units": {"acc": "g", "time": "V"}}, "column 'time [s]': 'V' is no unit of time"),
        ("force [N],acc [g]", {}, "0 time columns"),
        (
            "a [g],acc [g]",
            {},
            "2 acceleration columns in 'a [g], acc [g]': must be 1; choose one; state it, for example --columns",
        ),
    ],
)
def test_names_and_units_that_cannot_be(tmp_path: Path, header: str, options: dict[str, object], words: str) -> None:
    assert refusal(tmp_path, f"{header}\n{IN_G}", **options).startswith(words)


def test_a_column_of_ones_own_is_not_used_and_said_so(tmp_path: Path) -> None:
    rows = [line.replace(",", ",warm,") for line in IN_G.splitlines()]
    recording = load(tmp_path, "\n".join(["time [s],remark,acc [g]", *rows]))
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-6)
    assert recording.notes == ("column 'remark' not used: nothing here goes by such a name",)


def test_a_misspelt_quantity_is_no_column_of_ones_own(tmp_path: Path) -> None:
    """The refusal says how to skip it."""
    rows = [line.replace(",", ",21.5,") for line in IN_G.splitlines()]
    content = "\n".join(["time [s],positon_mm,acc [g]", *rows])
    said = refusal(tmp_path, content)
    assert "--columns 'time [s],-,acc [g]'" in said
    columns = said.partition("--columns '")[2].partition("'")[0].split(",")
    np.testing.assert_allclose(load(tmp_path, content, columns=columns).acceleration.values, TAP_M_S2, atol=1e-6)


# ---- times that are none -----------------------------------------------------------------------------------

ROWS = [row.partition(",")[2] for row in IN_G.split()]
FIFO = "time [s],acc [g]\n" + "".join(f"{(k // 32) * 32 * DT_S:.6f},{row}\n" for k, row in enumerate(ROWS))
DATES = {
    "2024-03-05 23:59:59.{0:06d}": 1e-6,
    "03/05/2024 11:59:59.{0:06d} PM": 1e-6,
    "23:59:59:{0:06d}": 1e-6,
    "5.3.24 23:59:{1:02d}.{2:04d}": 1e-4,
}


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (
            "acc [g]\n" + "\n".join(ROWS) + "\n",
            "0 time columns in 'acc[g]': must be 1; name one time_s or time_ms, or",
        ),
        (FIFO, "row 3: the times repeat, in groups of 32 rows, as of a sensor's buffer, and the sample rate is"),
    ],
)
def test_a_rate_stands_for_times_that_say_nothing(tmp_path: Path, content: str, said: str) -> None:
    message = refusal(tmp_path, content)
    assert message.startswith(said)
    proposed = float(message.partition("--rate-Hz ")[2].split(" ")[0])
    assert proposed == pytest.approx(1 / DT_S, rel=1e-3)
    recording = load(tmp_path, content, rate_Hz=proposed)
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-9)
    assert recording.acceleration.dt_s == pytest.approx(DT_S, rel=1e-3)


@pytest.mark.parametrize(
    "line",
    [
        "Sample rate: 10000 Hz",
        "# Sampling Frequency (kHz): 10",
        "Fs = 10 kHz",
        "SampleRate,1e4",
        "Sample rate;10,0 kHz",
        "Delta_X\t0.0001",
        "Increment,1.000000e-04",
        "Sample interval [µs]: 100",
        "Rate,10 kS/s",
    ],
)
def test_a_rate_in_the_files_head_stands_for_times_that_are_not_there(tmp_path: Path, line: str) -> None:
    recording = load(tmp_path, f"Logger X7\n{line}\nacc [g]\n" + "\n".join(ROWS))
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-9)
    assert recording.acceleration.dt_s == pytest.approx(DT_S, rel=1e-9)
    assert recording.notes == (
        f"no column of times; the sample rate of 10000 Hz is that of the file's line {' '.join(line.split())!r}",
    )


@pytest.mark.parametrize("lines", ["Rate: 100 Hz\nSample rate: 10000 Hz", "Rate: 10 MHz", "Rate: 0 Hz", "Frames: 9"])
def test_rates_that_contradict_each_other_or_are_none_are_asked_for(tmp_path: Path, lines: str) -> None:
    assert "0 time columns" in refusal(tmp_path, f"{lines}\nacc [g]\n" + "\n".join(ROWS))


@pytest.mark.parametrize("pack", [npz, mat])
def test_variables_without_times_have_a_rate(tmp_path: Path, pack: object) -> None:
    suffix = ".npz" if pack is npz else ".mat"
    content = pack(acceleration_m_s2=TAP_M_S2)  # type: ignore[operator]
    assert "--rate-Hz 10000" in refusal(tmp_path, content, suffix)
    recording = load(tmp_path, content, suffix, rate_Hz=10_000)
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-9)
    assert recording.acceleration.dt_s == pytest.approx(DT_S, rel=1e-12)


@pytest.mark.parametrize("form", DATES)
@pytest.mark.parametrize("name", ["Time", "rtcTime", "time [ms]"])
def test_dates_and_times_of_day_are_times(tmp_path: Path, form: str, name: str) -> None:
    stamps = [form.format(k, 50 + k // 10_000, k % 10_000) for k in range(len(ROWS))]
    rows = "".join(f"{stamp},{row}\n" for stamp, row in zip(stamps, ROWS, strict=True))
    recording = load(tmp_path, f"{name},Acc (g)\n{rows}")
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-6)
    assert recording.acceleration.dt_s == pytest.approx(DATES[form], rel=1e-6)


def test_midnight_and_noon_are_no_steps_back(tmp_path: Path) -> None:
    for before, after in (("23:59:59.9{:03d}", "00:00:00.0{:03d}"), ("12:59:59.9{:03d} AM", "01:00:00.0{:03d} AM")):
        stamps = [*(before.format(k) for k in range(900, 1000)), *(after.format(k) for k in range(100))]
        content = "Time,Acc (g)\n" + "".join(f"{s},{row}\n" for s, row in zip(stamps, ROWS, strict=True))
        assert load(tmp_path, content).acceleration.dt_s == pytest.approx(1e-4, rel=1e-6)


def test_few_rows_that_stand_there_twice_are_no_buffers(tmp_path: Path) -> None:
    rows = IN_G.splitlines()
    assert "sort the rows and remove repeated ones" in refusal(
        tmp_path, "\n".join(["time [s],acc [g]", *rows[:50], *rows[49:]])
    )


@pytest.mark.parametrize("delimiter", [",", ";"])
@pytest.mark.parametrize("offset", [0, 3])
def test_a_slower_channel_leaves_blanks_that_are_filled(tmp_path: Path, delimiter: str, offset: int) -> None:
    positions = 1e3 * np.cos(40 * TIMES_S)
    rows = [
        row + delimiter + (f"{z:.12g}" if k % 10 == offset else "")
        for k, (row, z) in enumerate(zip(IN_G.replace(",", delimiter).split(), positions, strict=True))
    ]
    recording = load(tmp_path, "\n".join([delimiter.join(["time [s]", "acc [g]", "pos [mm]"]), *rows]))
    known = slice(offset, 190 + offset + 1)
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2[known], atol=1e-9)
    assert recording.acceleration.start_s == pytest.approx(offset * DT_S)
    np.testing.assert_allclose(recording.position.values, 1e-3 * positions[known], atol=1e-6)
    assert recording.notes == ("pos [mm] stands in one row of 10 only, and is interpolated between them",)


@pytest.mark.parametrize("pack", [npz, mat])
def test_a_tail_of_nan_is_left_out_and_said_so(tmp_path: Path, pack: object) -> None:
    values = np.where(np.arange(TIMES_S.size) < 190, TAP_M_S2, np.nan)
    content = pack(time_s=TIMES_S, acc_m_s2=values)  # type: ignore[operator]
    recording = load(tmp_path, content, ".npz" if pack is npz else ".mat")
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2[:190], atol=1e-9)
    assert recording.notes == ("the last 10 rows hold what is no number (NaN), and are left out",)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16-le", "utf-16-be", "utf-16"])
@pytest.mark.parametrize("zeros", [2, 4096])
def test_a_tail_of_zero_bytes_is_left_out_and_said_so(tmp_path: Path, encoding: str, zeros: int) -> None:
    content = f"time [s],acc [g]\n{IN_G}".encode(encoding) + bytes(zeros)
    recording = load(tmp_path, content)
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-6)
    assert recording.notes == (f"{zeros} bytes at the end, zeros that a logger has not written over, are left out",)


def test_a_number_that_a_tail_of_zero_bytes_cuts_off_is_left_out(tmp_path: Path) -> None:
    recording = load(tmp_path, f"time [s],acc [g]\n{IN_G}0.02,-1".encode() + bytes(100))
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-6)
    assert recording.notes[0].startswith("107 bytes at the end")


@pytest.mark.parametrize("blank", [{5}, {5, 6, 7}, set(range(100, 200)), set(range(1, 200))])
def test_blanks_that_are_not_regular_are_lost_samples(tmp_path: Path, blank: set[int]) -> None:
    rows = [row.partition(",")[0] + "," if k in blank else row for k, row in enumerate(IN_G.split())]
    content = "\n".join(["time [s],acc [g]", *rows])
    if len(blank) > 1:
        said = refusal(tmp_path, content)
        assert said.startswith(f"row {min(blank) + 2}, column acc [g]: nan: must be finite")
        assert f"{len(blank)} of {len(rows)} are lost or blank, at most 1 % are interpolated; record again" in said
        return
    recording = load(tmp_path, content)
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=0.02 * np.abs(TAP_M_S2).max())
    assert recording.notes[0].startswith(f"1 of {len(rows)} samples lost or without a time, first after row 6")


def test_columns_in_the_wrong_order(tmp_path: Path) -> None:
    """A time that goes back all the while is none; one that goes back once has rows out of order."""
    swapped = "\n".join(",".join(reversed(line.split(","))) for line in IN_G.splitlines())
    assert "is another column the time's?" in refusal(tmp_path, f"time [s],acc [g]\n{swapped}")
    rows = IN_G.splitlines()
    rows[20], rows[21] = rows[21], rows[20]
    assert "sort the rows" in refusal(tmp_path, "\n".join(["time [s],acc [g]", *rows]))


def test_a_stated_unit_against_that_of_the_file_is_noted(tmp_path: Path) -> None:
    for name in ("acc [m/s^2]", "acceleration_m_s2"):
        recording = load(tmp_path, f"time [s],{name}\n{IN_G}", units={"acceleration": "G"})
        assert recording.notes == (f"the file's column is '{name}', --units says G, which is taken",)
    recording = load(tmp_path, f"time [SEC],acc [g]\n{IN_G}", units={"acceleration": "G", "time": "seconds"})
    assert recording.notes == ()


def test_units_of_a_command_line() -> None:
    assert stated_units("time=ms, acc=g") == {"time": "ms", "acc": "g"}
    with pytest.raises(InputError, match="--units acc: 'acc' has no unit; write --units"):
        stated_units("acc")


# ---- a unit at the end of any name ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "factor"),
    [
        *(("acc1_g", G), ("Acc 1 g", G), ("acc1 (g)", G), ("acc1 [g]", G), ("ai0_g", G), ("sensor_2_mg", 1e-3 * G)),
        *(("acc1_mps2", 1.0), ("acc1_ms2", 1.0), ("ai0_m_s2", 1.0), ("acc1_mmps2", 1e-3), ("acc1_mm_s2", 1e-3)),
    ],
)
def test_a_unit_at_the_end_is_the_unit_whatever_stands_before_it(tmp_path: Path, name: str, factor: float) -> None:
    recording = load(tmp_path, f"time_s,{name}\n" + text(TIMES_S, TAP_M_S2 / factor))
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, rtol=1e-9, atol=1e-9)


def test_of_two_sensors_one_is_chosen_and_keeps_its_unit(tmp_path: Path) -> None:
    both = "time_s,acc1_g,acc2_g\n" + text(TIMES_S, TAP_M_S2 / G, 2 * TAP_M_S2 / G)
    said = refusal(tmp_path, both)
    assert "2 acceleration columns" in said
    assert "--units" not in said
    chosen = load(tmp_path, both, columns=["time_s", "-", "acc2_g"])
    np.testing.assert_allclose(chosen.acceleration.values, 2 * TAP_M_S2, rtol=1e-9, atol=1e-9)
    contradicted = load(tmp_path, both, columns=["time_s", "-", "acc2_g"], units={"acceleration": "m/s^2"})
    assert any("the file's column is 'acc2_g', --units says m/s^2" in note for note in contradicted.notes)


@pytest.mark.parametrize("name", ["Channel A", "Probe C", "acc_min", "n m"])
def test_the_letter_of_a_channel_is_no_unit(name: str) -> None:
    assert apart(name) == (name, None)


@pytest.mark.parametrize(
    ("cell", "beside", "size"),
    [
        ('"1,234"', "20.11.2026", 1.234),  # the points of a date are no decimal points
        ('"1,234"', "10:11:12.123", 1.234),  # nor is that of a time of day
        ('"1,234"', "0.5", 1234.0),  # beside a decimal point a comma separates thousands
        ('"1,234"', "12", 1.234),
    ],
)
def test_a_quoted_comma_is_decimal_unless_a_number_of_its_row_has_a_point(
    cell: str, beside: str, size: float
) -> None:
    data = "".join(f"{beside},{cell}\n" for _ in range(9)).encode()
    rows = parted_text(data, VOCABULARY).rows
    assert all(float(cells_of(row)[1]) == pytest.approx(size, rel=1e-12) for row in rows)
