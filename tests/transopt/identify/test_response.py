"""Files of measured frequency responses: tables as instruments write them, and dataset 58 of universal files."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy import io

from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2, ComplexArray, FloatArray
from transopt.files.names import Layout
from transopt.identify.measured_response import read_response

F_HZ = np.linspace(10, 500, 50)
S = 2j * np.pi * F_HZ
W = 2 * np.pi * 150
G = np.asarray(3.0 * S**2 / (S**2 + W / 8 * S + W**2))


def table(path: Path, head: str, *columns: FloatArray, mark: str = ",") -> None:
    np.savetxt(path, np.column_stack(columns), header=head, comments="", delimiter=mark, fmt="%.17g")


DEGREES, DB = np.degrees(np.angle(G)), 20 * np.log10(np.abs(G))
TABLES: dict[str, Callable[[Path], None]] = {
    "real.csv": lambda p: table(p, "frequency_Hz,real,imag", F_HZ, G.real, G.imag),
    "polar.csv": lambda p: table(p, "frequency_Hz,magnitude,phase_deg", F_HZ, np.abs(G), DEGREES),
    "radian.csv": lambda p: table(p, "frequency_Hz,magnitude,phase_rad", F_HZ, np.abs(G), np.angle(G)),
    "level.csv": lambda p: table(p, "frequency_Hz,magnitude_dB,phase_deg", F_HZ, DB, DEGREES),
    "bode.txt": lambda p: table(p, "Frequency [Hz];Magnitude [dB];Phase [deg]", F_HZ, DB, DEGREES, mark=";"),
    "inverse.csv": lambda p: table(
        p,
        "f [kHz],Mag (g/V),Phase (rad)",
        F_HZ[::-1] / 1e3,
        np.abs(G)[::-1] / STANDARD_GRAVITY_M_S2,
        np.angle(G)[::-1],
    ),
    "with_dc.csv": lambda p: table(
        p, "frequency_Hz,real,imag", np.append(0.0, F_HZ), np.append(1.0, G.real), np.append(0.0, G.imag)
    ),
    "arrays.npz": lambda p: np.savez(p, frequency_Hz=F_HZ, real=G.real, imaginary=G.imag),
    "arrays.mat": lambda p: io.savemat(p, {"frequency_Hz": F_HZ, "magnitude": np.abs(G), "phase_deg": DEGREES}),
}


@pytest.mark.parametrize("name", TABLES)
def test_every_form_is_the_same_response(name: str, tmp_path: Path) -> None:
    TABLES[name](tmp_path / name)
    found = read_response(tmp_path / name)
    np.testing.assert_allclose(found.frequencies_Hz, F_HZ, rtol=1e-12)
    np.testing.assert_allclose(found.response, G, rtol=1e-12)


def test_scale_and_columns_that_state_nothing(tmp_path: Path) -> None:
    table(tmp_path / "r.csv", "a,b,c", F_HZ, G.real, G.imag)
    layout = Layout(("frequency_Hz", "real", "imag"))
    np.testing.assert_allclose(read_response(tmp_path / "r.csv", layout, scale=-2.0).response, -2 * G, rtol=1e-12)


def uff(
    kind: int,
    *,
    even: bool,
    function: int = 4,
    abscissa: int = 18,
    ordinate: int = 12,
    response: ComplexArray,
    units: tuple[str, str, str] = ("Hz", "m/s^2", "V"),
    f_Hz: FloatArray = F_HZ,
    denominator: int = 0,
    exponents: tuple[str, str] = ("    0    0    0", "    0    0    0"),
) -> str:
    """Dataset 58 as its description has it, in columns (SDRC Universal File Format)."""
    width = {5: "13.5E", 6: "20.12E"}[kind]
    cells = [[f"{x:{width}}" for x in (v.real, v.imag)] for v in response]
    if not even:
        cells = [[f"{f:13.5E}", *pair] for f, pair in zip(f_Hz, cells, strict=True)]
    per_line = 80 // len("".join(cells[0]))
    lines = ["".join("".join(point) for point in cells[k : k + per_line]) for k in range(0, len(cells), per_line)]
    step = float(f_Hz[1] - f_Hz[0]) if even else 0.0
    head = [
        "    58",
        "accelerance of a jig",
        *["NONE"] * 4,
        f"{function:5d}{1:10d}{1:5d}{0:10d} {'jig':10s}{1:10d}{3:4d} {'coil':10s}{1:10d}{3:4d}",
        f"{kind:10d}{f_Hz.size:10d}{int(even):10d}{f_Hz[0]:13.5E}{step:13.5E}{0.0:13.5E}",
        f"{abscissa:10d}{0:5d}{0:5d}{0:5d} {'Frequency':20s} {units[0]:20s}",
        f"{ordinate:10d}{exponents[0]} {'Acceleration':20s} {units[1]:20s}",
        f"{denominator:10d}{exponents[1]} {'Voltage':20s} {units[2]:20s}",
        f"{0:10d}{0:5d}{0:5d}{0:5d} {'NONE':20s} {'NONE':20s}",
    ]
    return "\n".join(["    -1", *head, *lines, "    -1"]) + "\n"


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize(("kind", "digits"), [(5, 1e-5), (6, 1e-11)])
def test_dataset_58(kind: int, digits: float, even: bool, tmp_path: Path) -> None:
    (tmp_path / "r.unv").write_text(uff(kind, even=even, response=G))
    found = read_response(tmp_path / "r.unv")
    np.testing.assert_allclose(found.frequencies_Hz, F_HZ, rtol=1e-5)
    np.testing.assert_allclose(found.response, G, rtol=digits)


def test_numbers_of_fixed_width_may_touch(tmp_path: Path) -> None:
    # Some compilers give every exponent three digits, so that the numbers touch.
    text = re.sub(r" (-?\d\.\d{5}E[+-])(\d\d)", r"\g<1>0\g<2>", uff(5, even=True, response=np.asarray(-G)))
    assert "E+000-" in text
    (tmp_path / "r.uff").write_text(text)
    np.testing.assert_allclose(read_response(tmp_path / "r.uff").response, -G, rtol=1e-5)


ABSCISSAE = {"Hz": 1.0, "kHz": 1e-3, "rad/s": 2 * np.pi}
ORDINATES = {
    "m/s^2": 1.0,
    "m/s2": 1.0,
    "m/s²": 1.0,
    "g": 1 / 9.80665,
    "mg": 1e3 / 9.80665,
    "mm/s^2": 1e3,
}
INPUTS = {
    "A": (1.0, "current"),
    "mA": (1e3, "current"),
    "V": (1.0, "voltage"),
    "mV": (1e3, "voltage"),
    "NONE": (1.0, ""),
}


@pytest.mark.parametrize(
    ("abscissa", "ordinate", "of_input"),
    [
        *((unit, "m/s^2", "V") for unit in ABSCISSAE),
        *(("kHz", unit, "mA") for unit in ORDINATES),
        *(("rad/s", "mg", unit) for unit in INPUTS),
    ],
)
def test_a_response_is_the_same_in_whatever_units_its_labels_say(
    abscissa: str, ordinate: str, of_input: str, tmp_path: Path
) -> None:
    per, driven_by = INPUTS[of_input]
    text = uff(
        6,
        even=False,
        response=np.asarray(G * ORDINATES[ordinate] / per),
        units=(abscissa, ordinate, of_input),
        f_Hz=F_HZ * ABSCISSAE[abscissa],
    )
    (tmp_path / "r.uff").write_text(text, encoding="utf-8")
    found = read_response(tmp_path / "r.uff")
    np.testing.assert_allclose(found.frequencies_Hz, F_HZ, rtol=1e-5)
    np.testing.assert_allclose(found.response, G, rtol=1e-10)
    assert (found.driven_by, found.notes) == (driven_by, ())


def test_a_ratio_may_stand_in_the_ordinate_alone_and_a_label_in_another_encoding(tmp_path: Path) -> None:
    text = uff(6, even=True, response=np.asarray(G / 9.80665), units=("Hz", "g/V", "NONE"))
    (tmp_path / "r.uff").write_text(text)
    np.testing.assert_allclose(read_response(tmp_path / "r.uff").response, G, rtol=1e-10)
    (tmp_path / "r.uff").write_text(uff(6, even=True, response=G, units=("Hz", "m/s²", "V")), encoding="latin-1")
    np.testing.assert_allclose(read_response(tmp_path / "r.uff").response, G, rtol=1e-10)


def test_the_users_units_go_before_the_labels_and_the_contradiction_is_named(tmp_path: Path) -> None:
    (tmp_path / "r.uff").write_text(uff(6, even=True, response=np.asarray(G / 9.80665)))
    found = read_response(tmp_path / "r.uff", Layout(units={"magnitude": "g/A"}))
    np.testing.assert_allclose(found.response, G, rtol=1e-10)
    assert found.driven_by == "current"
    assert found.notes == ("the file's column is 'accelerance [m/s^2/V]', --units says g/A, which is taken",)


@pytest.mark.parametrize(
    ("units", "layout", "said"),
    [
        (
            ("Hz", "furlong", "V"),
            Layout(),
            r"'furlong/V' is no unit of magnitude; known: m/s.* state it, for example --units 'magnitude=m/s\^2/V",
        ),
        (
            ("rpm", "g", "V"),
            Layout(),
            "'rpm' is no unit of frequency; known: Hz, kHz, rad/s; state it, for example --units frequency=Hz",
        ),
        (("Hz", "g", "N"), Layout(), "its denominator is in 'N', neither a current nor a voltage"),
        (
            ("Hz", "g", "V"),
            Layout(("a", "b")),
            "--columns a,b .*: WAV and universal files have no columns; leave it out and choose one",
        ),
        (
            ("Hz", "g", "V"),
            Layout(units={"acc": "g"}),
            r"--units acc: no column of that name; the file has 'frequency \[Hz\], accelerance \[g/V\]'",
        ),
        (
            ("Hz", "g", "V"),
            Layout(units={"magnitude": "dB"}),
            "is complex, and a level in dB has no phase; state its unit, --units magnitude=m/s",
        ),
    ],
)
def test_what_says_nothing_of_a_universal_file_is_refused(
    units: tuple[str, str, str], layout: Layout, said: str, tmp_path: Path
) -> None:
    (tmp_path / "r.uff").write_text(uff(6, even=True, response=G, units=units))
    with pytest.raises(InputError, match=said):
        read_response(tmp_path / "r.uff", layout)


NONE = ("Hz", "NONE", "NONE")
FORCE = "    0    1    0"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            uff(6, even=True, response=G, units=NONE, denominator=13),
            "its denominator is an excitation force by its ty",
        ),
        (uff(6, even=True, response=G, units=NONE, denominator=9), "its denominator is a reaction force by its type"),
        (uff(6, even=True, response=G, units=NONE, denominator=12), "its denominator is an acceleration by its type"),
        (
            uff(6, even=True, response=G, units=NONE, denominator=99),
            "its denominator is a quantity of type 99 by its",
        ),
        (
            uff(6, even=True, response=G, units=NONE, denominator=1, exponents=("", FORCE)),
            r"its denominator is length\^0 force\^1 temperature\^0 by its type, neither a current",
        ),
        (
            uff(6, even=True, response=G, units=NONE, ordinate=1, exponents=(FORCE, "")),
            r"its ordinate is length\^0 force\^1 temperature\^0, no acceleration \(type 12\)",
        ),
    ],
)
def test_types_and_exponents_say_what_labels_do_not(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "r.uff").write_text(text)
    with pytest.raises(InputError, match=said):
        read_response(tmp_path / "r.uff")
    found = read_response(tmp_path / "r.uff", Layout(units={"magnitude": "g/V"}))
    np.testing.assert_allclose(found.response, 9.80665 * G, rtol=1e-10)
    assert found.driven_by == "voltage"


@pytest.mark.parametrize("exponents", ["", "    0    0    0", "    1    0    0"])
def test_a_general_ordinate_may_be_an_acceleration_and_a_label_goes_before_a_type(
    exponents: str, tmp_path: Path
) -> None:
    """Lengths have the exponents of an acceleration, since time has none; blank fields say nothing."""
    text = uff(6, even=True, response=G, ordinate=1, denominator=13, exponents=(f"{exponents:15s}", FORCE))
    (tmp_path / "r.uff").write_text(text)
    found = read_response(tmp_path / "r.uff")
    np.testing.assert_allclose(found.response, G, rtol=1e-10)
    assert found.driven_by == "voltage"


def test_a_velocity_by_its_label_becomes_an_acceleration(tmp_path: Path) -> None:
    (tmp_path / "r.uff").write_text(uff(6, even=True, response=G, units=("Hz", "mm/s", "V")))
    table(tmp_path / "r.csv", "f (Hz),Mag (mm/s/V),phase_deg", F_HZ, np.abs(G), DEGREES)
    for name in ("r.uff", "r.csv"):
        found = read_response(tmp_path / name)
        np.testing.assert_allclose(found.response, 2j * np.pi * F_HZ * 1e-3 * G, rtol=1e-6)


RATIOS = {"G/V": (9.80665, "voltage"), "(m/s²)/mV": (1e3, "voltage"), "m/sec^2 per Amp": (1.0, "current")}


@pytest.mark.parametrize("unit", RATIOS)
@pytest.mark.parametrize("f_Hz", [("HZ", 1.0), ("Hertz", 1.0), ("rad/sec", 2 * np.pi)])
def test_labels_of_tables_say_what_the_response_is_to(unit: str, f_Hz: tuple[str, float], tmp_path: Path) -> None:
    factor, driven_by = RATIOS[unit]
    in_unit = G / factor
    heads = {
        f"Freq [{f_Hz[0]}];Mag [{unit}];Phase [Degrees]": (np.abs(in_unit), DEGREES),
        f"Freq [{f_Hz[0]}];Re [{unit}];Im [{unit}]": (in_unit.real, in_unit.imag),
    }
    for head, columns in heads.items():
        table(tmp_path / "r.csv", head, F_HZ * f_Hz[1], *columns, mark=";")
        found = read_response(tmp_path / "r.csv")
        np.testing.assert_allclose(found.frequencies_Hz, F_HZ, rtol=1e-12)
        np.testing.assert_allclose(found.response, G, rtol=1e-12)
        assert (found.driven_by, found.notes) == (driven_by, ())


def test_units_that_mean_the_same_are_no_contradiction(tmp_path: Path) -> None:
    (tmp_path / "r.uff").write_text(uff(6, even=True, response=G))
    table(tmp_path / "r.csv", "f [Hz],Mag [m/s^2/V],phase_deg", F_HZ, np.abs(G), DEGREES)
    for unit in ("m/s2/V", "M/S^2/VOLT", "m/s²", "mm/s^2/mV"):
        for name in ("r.uff", "r.csv"):
            found = read_response(tmp_path / name, Layout(units={"magnitude": unit, "frequency": "HERTZ"}))
            np.testing.assert_allclose(found.response, G, rtol=1e-9)
            assert (found.driven_by, found.notes) == ("voltage", ())


def test_a_word_about_the_input_against_the_units_is_refused_with_what_settles_it(tmp_path: Path) -> None:
    (tmp_path / "r.uff").write_text(uff(6, even=True, response=G, units=("Hz", "g", "V")))
    table(tmp_path / "r.csv", "f [Hz],re [g/V],im [g/V]", F_HZ, G.real, G.imag)
    for name in ("r.uff", "r.csv"):
        with pytest.raises(InputError, match=r"--input current: its unit g/V says that .* to a voltage") as caught:
            read_response(tmp_path / name, driven_by="current")
        units = dict(pair.split("=") for pair in str(caught.value).partition("state --units ")[2].split(","))
        found = read_response(tmp_path / name, Layout(units=units), driven_by="current")
        assert found.driven_by == "current"
        np.testing.assert_allclose(found.response, 9.80665 * G, rtol=1e-10)
        assert read_response(tmp_path / name, driven_by="voltage").driven_by == "voltage"


def test_parts_in_different_units_are_refused_with_what_settles_it(tmp_path: Path) -> None:
    for other in ("im [g/A]", "imag"):
        table(tmp_path / "r.csv", f"f [Hz],re [g/V],{other}", F_HZ, G.real, G.imag)
        with pytest.raises(InputError, match="state the unit of both by --units real=m/s") as caught:
            read_response(tmp_path / "r.csv")
        units = dict(pair.split("=") for pair in str(caught.value).partition("by --units ")[2].split(","))
        np.testing.assert_allclose(read_response(tmp_path / "r.csv", Layout(units=units)).response, G, rtol=1e-10)


def test_a_scale_besides_a_unit_that_is_converted_is_named(tmp_path: Path) -> None:
    (tmp_path / "r.uff").write_text(uff(6, even=True, response=np.asarray(G / 9.80665), units=("Hz", "g", "V")))
    found = read_response(tmp_path / "r.uff", scale=9.80665)
    np.testing.assert_allclose(found.response, 9.80665 * G, rtol=1e-10)
    assert found.notes == (
        "g/V is converted to m/s^2 per A or V, and --scale 9.80665 multiplies besides: leave it out if it stands for "
        "the unit",
    )
    assert read_response(tmp_path / "r.uff", scale=-1.0).notes == ()
    # A level has no unit, and a column without one is what the scale is for.
    for head, columns in {"magnitude_dB": (DB, DEGREES), "magnitude": (np.abs(G), DEGREES)}.items():
        table(tmp_path / "r.csv", f"frequency_Hz,{head},phase_deg", F_HZ, *columns)
        assert read_response(tmp_path / "r.csv", scale=9.80665).notes == ()


@pytest.mark.parametrize("name", ["r.uff", "r.csv"])
def test_what_only_sounds_have_is_refused_of_a_response(name: str, tmp_path: Path) -> None:
    (tmp_path / "r.uff").write_text(uff(6, even=True, response=G))
    table(tmp_path / "r.csv", "frequency_Hz,real,imag", F_HZ, G.real, G.imag)
    said = (
        "only WAV and universal files have"
        if name == "r.csv"
        else "the file has 1 frequency responses; choose 1 to 1"
    )
    with pytest.raises(InputError, match=rf"{name}: --channel 2.*: {said}"):
        read_response(tmp_path / name, Layout(channel=2))
    with pytest.raises(InputError, match=rf"{name}: --full-scale 9 .*: only a WAV file has a full scale; leave it"):
        read_response(tmp_path / name, Layout(full_scale_m_s2=9.0))


def test_a_sound_is_no_response(tmp_path: Path) -> None:
    (tmp_path / "r.wav").write_bytes(b"RIFF")
    with pytest.raises(
        InputError, match=r"r\.wav: a WAV file holds a signal, no frequency response; export the resp"
    ):
        read_response(tmp_path / "r.wav")


def test_a_unit_of_the_acceleration_alone_leaves_the_input_to_the_label(tmp_path: Path) -> None:
    (tmp_path / "r.uff").write_text(uff(6, even=True, response=G, units=("Hz", "furlong", "mV")))
    found = read_response(tmp_path / "r.uff", Layout(units={"magnitude": "g"}))
    np.testing.assert_allclose(found.response, 9.80665e3 * G, rtol=1e-10)
    assert found.driven_by == "voltage"


WHOLE = uff(6, even=True, response=G)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (uff(6, even=True, response=G, function=1), "0 frequency responses in 1 datasets 58; export one"),
        (
            WHOLE + WHOLE,
            "2 frequency responses, and which is the .*: 1 'accelerance of a jig', 2 .*; state it, .* --channel 1",
        ),
        (uff(6, even=True, response=G, abscissa=17), "its abscissa is no frequency"),
        (uff(6, even=True, response=G, ordinate=8), r"is a displacement, no acceleration \(type 12\); export"),
        ("\n".join([*WHOLE.splitlines()[:-4], "    -1"]), "88 numbers, its head promises 100; it is cut short"),
        (WHOLE.replace("         6        50", "         2        50"), "ordinate type 2, must be 5 or 6, complex"),
        (
            WHOLE.replace("         6        50", "         6      many"),
            "number of points is 'many', no whole number",
        ),
        (WHOLE.replace("    58\n", "    58b\n"), "0 numbers, its head promises 100; it is cut short"),
        ("    -1\n   164\n         3 mm\n    -1\n" + WHOLE, "dataset 164: units other than SI"),
        ("nothing", "no dataset between two lines of -1"),
        (WHOLE.replace("E-0", "X-0", 1), "is no number; export it again"),
    ],
)
def test_universal_files_that_hold_no_response(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "r.unv").write_text(text)
    with pytest.raises(InputError, match=said) as caught:
        read_response(tmp_path / "r.unv")
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("head", "columns", "said"),
    [
        ("frequency_Hz,magnitude", [F_HZ, np.abs(G)], "a response has frequency_Hz and either magnitude"),
        ("real,imag", [G.real, G.imag], "0 frequency columns"),
        ("frequency_Hz,magnitude,phase_deg", [F_HZ, DB, DEGREES], "a magnitude is negative: is it in dB"),
        ("frequency_Hz,real,imag", [F_HZ * 0 + 5, G.real, G.imag], "5 Hz stands there twice"),
        ("frequency_Hz,real,imag", [F_HZ, G.real * 1e12, G.imag], "point 1: 10 Hz, .*at most 1e.09"),
        ("frequency_Hz,real,imag", [F_HZ[:5], G.real[:5], G.imag[:5]], "5 frequencies above 0, at least 8"),
        ("f [Hz],Mag (ohm),phase_deg", [F_HZ, np.abs(G), DEGREES], "'ohm' is no unit of magnitude; known: m/s"),
        ("frequency_Hz,real,imag,magnitude", [F_HZ, G.real, G.imag, np.abs(G)], "either magnitude"),
    ],
)
def test_tables_that_are_no_response(head: str, columns: list[FloatArray], said: str, tmp_path: Path) -> None:
    table(tmp_path / "r.csv", head, *columns)
    with pytest.raises(InputError, match=said) as caught:
        read_response(tmp_path / "r.csv")
    assert str(caught.value).isprintable()
    assert "r.csv: " in str(caught.value)
