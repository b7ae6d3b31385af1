"""Splits a text into the lines above the numbers, names and units of the columns, and rows of cells.

Instruments and loggers write names below remarks, units in a separate row or among their notes, notes beside the
numbers, or a label before each number.
"""

import codecs
import io
import re
from array import array
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from transopt.base.errors import InputError
from transopt.base.sizes import MOST_COLUMNS, MOST_IN_A_ROW
from transopt.files.names import SKIPPED, Vocabulary, labelled, quote, split_names, with_axes
from transopt.files.raw_table import MIN_SAMPLES, check_size
from transopt.files.statements import DECIMAL_COMMA, REMARKS, described, stated_in
from transopt.files.units import is_unit

HEAD = 65536  # leading bytes in which units are looked for and the encoding is recognised
_ZERO_BYTES = 0.4  # share of zeros among every second byte: above it in UTF-16 of mostly ASCII text
_CODE_PAGES = ("cp1252", "cp850", "mac_roman")  # Windows, its console and DOS, Mac OS before X: western Europe
_CONTROLS = "".join(map(chr, [*range(9), *range(14, 26), *range(28, 32)]))  # absent from text in any page
_BEYOND_ASCII = re.compile(r"[^\s,;:\"()\[\]{}]*[^\x00-\x7f\s][^\s,;:\"()\[\]{}]*")


def filled(data: bytes) -> bytes:
    """The whole lines before a tail of zero bytes: a logger that loses its power leaves a file's rest empty."""
    text = data.rstrip(b"\0")
    if 0 in text:
        return data[: len(text) + len(text) % 2]  # of UTF-16 a last zero belongs to the text
    ended = max(text.rfind(b"\n"), text.rfind(b"\r")) + 1
    return text[:ended] if ended and len(text) < len(data) else data  # a number that is cut off is another number


def encoding_of(data: bytes) -> str:
    """Name of the encoding: by the byte-order mark, the pattern of zero bytes, as UTF-8, or a code page.

    Code pages map the same bytes to different characters, and a few such bytes are too few for statistics. The first
    page under which a unit can be read is chosen.

    Raises
    ------
    InputError : the bytes are text in no known encoding.
    """
    pairs = data[: min(len(data), HEAD) // 2 * 2]
    even, odd = (2 * pairs[k::2].count(0) / max(len(pairs), 1) for k in (0, 1))
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        name = "utf-16"
    elif max(even, odd) > _ZERO_BYTES > min(even, odd):
        name = "utf-16-be" if even > odd else "utf-16-le"
    else:
        name = "utf-8-sig"
    bad = _undecodable(data, name.removesuffix("-sig"), "\0")
    if bad is None:
        return name
    pages = [page for page in _CODE_PAGES if _undecodable(data, page, _CONTROLS) is None]
    if name == "utf-8-sig" and not data.startswith(codecs.BOM_UTF8) and pages:
        return next((page for page in pages if _has_units(data[:HEAD].decode(page))), pages[0])
    row = data.count(b"\n", 0, bad) + 1
    raise InputError(f"row {row}: byte 0x{data[bad]:02x} is not UTF-8 text; save it as UTF-8 text")


def _undecodable(data: bytes, name: str, controls: str) -> int | None:
    """Position of the first undecodable byte or control character; None if there is none."""
    try:
        text = data.decode(name)
    except UnicodeDecodeError as error:
        return error.start
    places = [at for character in controls if (at := text.find(character)) >= 0]
    return min(places, default=None)


def _has_units(text: str) -> bool:
    """Whether a word with a non-ASCII character is a unit, or ends in a unit after a slash."""
    words = {word for found in _BEYOND_ASCII.findall(text) for word in (found, found.partition("/")[2])}
    return any(map(is_unit, words))


_HEAD_ROWS = 4  # rows above the numbers that are searched for names, units and comments of columns
_WHEN = re.compile(r"\d:\d|\d/\d+/\d|\d-\d+-\d")  # a date or a time of day, which is no column name
_UNIT_CELL = re.compile(r"[\[(]([^\[\]()]+)[\])]")
_QUOTED = re.compile(r'"([^"]*)"')
MOST_BELOW = 50  # most lines below the numbers that are left out; more are of unknown meaning
_LAST_ROWS = 20  # rows at the end of a file that show how its rows are divided
_THOUSANDS = re.compile(r"[-+]?\d{1,3}(,\d{3})+(\.\d*)?")  # commas between thousands, in a row with decimal points
_POINTED = re.compile(r"[-+]?[1-9]\d{0,2}((\.\d{3})+,\d*|(\.\d{3}){2,})")  # points between thousands
_EITHER = re.compile(r"[-+]?[1-9]\d{0,2}\.\d{3}")  # 1.069, which means 1069 beside decimal commas
_POINT = re.compile(r"(?<![\d.:])\d+\.\d+(?![\d.])")  # a decimal point, not one in a date or a time of day
_NUMBER = re.compile(r"[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?|")  # or an empty cell
_STAMP = re.compile(r"[-+]?(nan|inf)|[-+\d.,:/TZE ]+", re.IGNORECASE)  # a number, a date or a time of day
_WORTH = re.compile(r"\d|nan|inf", re.IGNORECASE)  # required in a stamp, so that dashes alone are none
_STATED = re.compile(r"[A-Za-z]\w*\s*=\s*[-+.\d]\S*")
_LABELLED = re.compile(r"\b([A-Za-z]\w*)\s*[:=]\s*([-+.\d][^\s,;]*)")
_SERIAL_STAMP = re.compile(r"\d+:\d+:\d+[.,]\d+ -> ")  # prefix of each line in Arduino's serial monitor
_NUMBER_START = re.compile(r"[-+.]*\d|[-+]?(nan|inf)", re.IGNORECASE)


class Text(NamedTuple):
    """The parts of a text.

    Attributes
    ----------
    rows, numbers : lines of numbers, and the row number of each in the file.
    names : names of the columns with their units, as in the file; empty if it has none.
    header : name -> value of what remarks state.
    head, told : lines above and below the numbers; statements in cells beside names and numbers.
    footer : lines below the numbers, which are left out.
    """

    rows: list[str]
    numbers: "array[int]"
    names: list[str]
    header: dict[str, object]
    head: list[str]
    told: list[str]
    footer: list[str]


def parted_text(data: bytes, words: Vocabulary, columns: int = 0) -> Text:
    """Split a text into its parts; `columns` is the number of columns that the user names.

    Raises
    ------
    InputError : there are no rows, or too many columns.
    """
    data, header = filled(data), dict[str, object]()
    rows, numbers, remark = _lines(data, header, words)
    if not rows:
        raise InputError(f"no rows of numbers, at least {MIN_SAMPLES} are needed; record or export it again")
    footer = _below(rows, numbers)
    names, told = _labelled(rows), _beside(rows)
    start = _first_of_numbers(rows)
    above, first = rows[:start], rows[min(start, len(rows) - 1)]
    if max(columns, *(len(row.split(mark)) for row in (first, *above[-2:]) for mark in ";,\t")) > MOST_COLUMNS:
        raise InputError(f"row {numbers[0]}: more than {MOST_COLUMNS} columns; export the ones that are needed")
    width = len(cells_of(first.rstrip(";, \t")))
    head = data[:HEAD].decode(encoding_of(data), errors="ignore").splitlines()
    del head[numbers[min(start, len(rows) - 1)] - 1 :]
    by_blanks = delimiter_of(first) is None
    lines = [
        split_names(row, by_blanks=by_blanks or any(words.quantity_of(name) for name in row.split())) for row in above
    ]
    for row in above:
        header |= stated_in(row, words)
    names = names or _names_above(lines[-_HEAD_ROWS:], width, words, told)
    if not names:
        names = split_names(remark.lstrip("".join(REMARKS) + "; "))
        if names[:1] and names[0].lower() in ("headers", "columns") and len(names) == len(cells_of(first)) + 1:
            del names[0]
        known = words.labelled(names)
        if len(names) != len(cells_of(first)) or all(known.quantity_of(name) is None for name in names):
            names = []
    names = with_axes(described(names, width, [*head, *told]))
    del rows[:start], numbers[:start]
    return Text(rows, numbers, names, header, [*head, *footer], told, footer)


def _below(rows: list[str], numbers: "array[int]") -> list[str]:
    """Remove the lines that a logger writes below its numbers: an end mark, statistics, or an incomplete row.

    Parameters
    ----------
    rows, numbers : the lines are removed from these.
    """
    usual = rows[len(rows) // 2]
    mark = delimiter_of(usual)

    def is_of_numbers(row: str) -> bool:
        first = row.split(mark, 1)[0].strip()
        return not first or bool(_STAMP.fullmatch(first) and _WORTH.search(first))

    if not is_of_numbers(usual):
        return []
    last = range(len(rows), max(len(rows) - MOST_BELOW, len(rows) // 2), -1)
    end = next((at for at in last if is_of_numbers(rows[at - 1])), len(rows))
    *before, cut = (row.split(mark) for row in rows[max(end - _LAST_ROWS, 0) : end])
    if len(before) >= MIN_SAMPLES and all(cell.strip() for cells in before for cell in cells):
        width = len(before[-1])
        is_short = len(cut) < width or not all(cell.strip() for cell in cut[:width])
        end -= int(is_short)
    footer = rows[end:]
    del rows[end:], numbers[end:]
    return footer


def _labelled(rows: list[str]) -> list[str]:
    """Names that precede each number of a row, as for a serial plotter; they are removed from the rows."""
    usual = rows[len(rows) // 2]
    names = [found[1] for found in _LABELLED.finditer(usual)]
    unit = _LABELLED.sub("", usual).strip(" ,;\t")
    if not names or (unit and not is_unit(unit)):
        return []
    for at, row in enumerate(rows):
        numbers = [found[2] for found in _LABELLED.finditer(row)]
        rows[at] = ",".join(numbers) if len(numbers) == len(names) else row
    return [labelled(name, unit) for name in names]


def _beside(rows: list[str]) -> list[str]:
    """Notes that an oscilloscope (Tektronix TDS) writes in the cells before the numbers of its first rows.

    Parameters
    ----------
    rows : the cells are removed from these.
    """
    cells = [row.split(",") for row in (rows[0], rows[-1])]
    notes = next((at for at, cell in enumerate(cells[-1]) if cell.strip()), 0)
    if notes < 2 or not cells[0][0].strip() or len(cells[0]) != len(cells[1]):
        return []
    if not all(_NUMBER.fullmatch(cell.strip()) for cell in cells[0][notes:]):
        return []
    parted = [row.split(",", notes) for row in rows]
    rows[:] = [cells[-1].rstrip(", ") for cells in parted]
    return [",".join(cells[:-1]).rstrip(",") for cells in parted if cells[0].strip()]


def _lines(data: bytes, header: dict[str, object], words: Vocabulary) -> tuple[list[str], "array[int]", str]:
    """Lines that are neither empty nor remarks, their row numbers, and the last remark above the numbers.

    Parameters
    ----------
    header : receives what remarks state.
    """
    remark, marks = "", REMARKS
    rows, numbers = list[str](), array("l")  # up to millions of rows, so no list of int objects
    check_size(max(data.count(b"\n"), data.count(b"\r")))
    for number, line in enumerate(io.TextIOWrapper(io.BytesIO(data), encoding_of(data), newline=None), 1):
        if len(line) > MOST_IN_A_ROW:
            remedy = "put one sample in a row, and only the columns that are needed; shorten a remark"
            raise InputError(f"row {number}: {len(line)} characters, at most {MOST_IN_A_ROW}; {remedy}")
        content = (_QUOTED.sub(_unquoted, line).replace('"', "") if '"' in line else line).strip(" \r\n\0\f\v")
        content = content if content.strip() else ""  # a tab at the start of a row ends an empty cell
        if number == 1:
            # A logger that separates cells by commas may begin its remarks with semicolons.
            marks = REMARKS + (";",) * (content[:1] == ";" and "," in content)
            if content.lower().startswith("sep="):
                continue  # a spreadsheet's note on its delimiter
        content = _SERIAL_STAMP.sub("", content, count=1) if " -> " in content else content
        if content.startswith(marks):
            _put_remark(number, content, header, words)
            remark = remark if rows and _NUMBER_START.match(rows[-1]) else content
        elif content:
            rows.append(content)
            numbers.append(number)
    return rows, numbers, remark


def _put_remark(number: int, line: str, header: dict[str, object], words: Vocabulary) -> None:
    """Add what a remark states to `header`."""
    for key, value in stated_in(line, words).items():
        if key in header:
            raise InputError(f"row {number}: {key} is stated a second time; keep one of the lines")
        if key not in words.header:
            known = f"known: {', '.join(words.header)}"
            raise InputError(f"row {number}: unknown header key {quote(key)}; {known}; correct or reword it")
        header[key] = value


def _unquoted(cell: re.Match[str]) -> str:
    """Content of a quoted cell; a comma in it becomes a decimal point, or a blank in a name."""
    inside = cell[1].strip()
    if cell[0] == cell.string.strip():
        return inside  # the whole row is quoted
    if _THOUSANDS.fullmatch(inside) and _POINT.search(cell.string):
        return inside.replace(",", "")
    return inside.replace(",", "." if DECIMAL_COMMA.fullmatch(inside) else " ")


def cells_of(row: str) -> list[str]:
    return [cell.strip() for cell in row.split(delimiter_of(row), MOST_COLUMNS)]


def with_points(cells: list[str], where: str = "") -> list[str]:
    """Cells between semicolons or tabs with decimal points for commas; points between thousands are removed.

    Raises
    ------
    InputError : beside decimal commas, a point may be either decimal or between thousands.
    """
    numbers = [cell.strip() for cell in cells]
    if any("," in cell and (DECIMAL_COMMA.fullmatch(cell) or _POINTED.fullmatch(cell)) for cell in numbers):
        if (either := next(filter(_EITHER.fullmatch, numbers), None)) is not None:
            problem = f"{either} stands beside decimal commas: is its point a decimal one, or between thousands?"
            raise InputError(f"{where}: {problem} write decimal commas, or points throughout")
        cells = [cell.replace(".", "") if _POINTED.fullmatch(cell) else cell for cell in numbers]
    return [cell.replace(",", ".") for cell in cells]


def _first_of_numbers(rows: Sequence[str]) -> int:
    """Index of the first row of numbers: it begins with a number, and is divided like the last rows or has no words.

    Names, units and an instrument's notes stand above it. If no row qualifies, it is the first row with a number
    anywhere.
    """
    usual = Counter((delimiter_of(row), len(cells_of(row))) for row in rows[-_LAST_ROWS:]).most_common(1)[0][0]

    def is_first(row: str) -> bool:
        cells = cells_of(row)
        wordless = len(cells) > 1 and all(map(_NUMBER.fullmatch, cells))
        return wordless or ((delimiter_of(row), len(cells)) == usual and bool(_STAMP.fullmatch(cells[0] or "0")))

    has_number = (k for k, row in enumerate(rows) if any(map(_NUMBER_START.match, cells_of(row))))
    begins = (k for k, row in enumerate(rows) if _NUMBER_START.match(row.lstrip(" \t,;")) and is_first(row))
    return next(begins, next(has_number, len(rows)))


def _names_above(above: list[list[str]], width: int, words: Vocabulary, told: list[str]) -> list[str]:
    """Names and units of the columns from the last rows above the numbers; empty if no row has enough cells.

    Parameters
    ----------
    width : number of cells in a row of numbers.
    told : receives numbers in a row of units below their names, such as `Increment: 1e-4`; such columns have no rows.
    """
    # LabChart writes `TopValue=` and such before the values of its channels.
    above = [cells for cells in above if not (cells and cells[0].endswith("="))]
    lines = [cells for cells in above if len(cells) >= width or cells is above[-1]]
    if lines and any(map(_WHEN.search, lines[-1])):
        return []
    if lines and len(lines[-1]) < width and all(words.quantity_of(name) is None for name in lines[-1]):
        del lines[-1]
    if not lines:
        return []
    for at in range(len(lines) - 1, 0, -1):
        if units := _units_of(lines[at], len(lines[at - 1])):
            return list(map(labelled, lines[at - 1], units))
    names, heads = lines[-1], lines[-2] if len(lines) > 1 else []
    if len(heads) == len(names) > 2 and any(cell and _NUMBER.fullmatch(cell) for cell in names):
        told += [f"{name}: {cell}" for name, cell in zip(heads, names, strict=True) if _NUMBER.fullmatch(cell)]
        heads = [SKIPPED if _NUMBER.fullmatch(cell) else name for name, cell in zip(heads, names, strict=True)]
        return list(map(labelled, heads, [cell if is_unit(cell) else "" for cell in names]))
    told += [name.replace("=", ":") for name in names if _STATED.fullmatch(name)]  # t0 = -0.06, tInc = 1e-4
    return [SKIPPED if _STATED.fullmatch(name) else name for name in names]


def _units_of(cells: Sequence[str], columns: int) -> list[str]:
    """Units in a row below the names, in brackets or bare; empty if the row has none."""
    inside = [found[1] for cell in cells if (found := _UNIT_CELL.fullmatch(cell))]
    units = inside if len(inside) == len(cells) else [cell for cell in cells if is_unit(cell)]
    return units if len(units) == len(cells) == columns else []


def delimiter_of(line: str) -> str | None:
    """Delimiter of the cells in a row; None for white space."""
    # Between tabs with one number per cell, and between semicolons, a comma is a decimal comma.
    if "\t" in line:
        cells = [cell.strip() for cell in line.split("\t")]
        if all(_NUMBER.fullmatch(cell) or (_STAMP.fullmatch(cell) and _WHEN.search(cell)) for cell in cells) and (
            "," in line or all(cells) or not cells[0]
        ):
            return "\t"
    return next((mark for mark in (";", ",") if mark in line), None)
