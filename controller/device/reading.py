"""Find, read and write device files; an error is one line with file, key, value and limit."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from controller.device.device_file import BUILT_IN, TABLES, DeviceFile
from transopt.base.errors import InputError, did_you_mean
from transopt.base.files import is_file, whole_file
from transopt.base.toml import parse_toml, read_text, read_toml, section_of, toml_value
from transopt.base.toml_edit import edited

BESIDE = "device.toml"  # name of the device file in the folder of a library
EXAMPLES = Path(__file__).parent / "examples"
ADVICE = "a device file is TOML; `transopt-play device new FILE` writes one"
OF_A_CIRCUIT = "power"  # a table of every circuit file, which no device file has


@dataclass(frozen=True)
class Described:
    """A device and the source of its description.

    Attributes
    ----------
    device : the stated values of its file, with defaults of the built-in device.
    path : path of the file; None for the built-in device and the examples.
    source : source in words, for one line.
    stated : keys like `encoder.count_m` that the file states.
    """

    device: DeviceFile
    path: Path | None
    source: str
    stated: frozenset[str]

    @property
    def in_words(self) -> str:
        """One line that tells which numbers come from the file and which from the built-in device."""
        # Keys without a value take nothing from the built-in device: they are the library's or the device's own.
        unstated = [key for key in all_keys() if key not in self.stated and value_of(self.device, key) is not None]
        if not self.stated:
            return f"device: {self.source}; `transopt-play device new FILE` describes your own"
        rest = f"; the built-in device's: {', '.join(unstated)}" if unstated else ""
        return f"device: {self.source}{rest}"


def all_keys() -> Iterator[str]:
    """`table.key` of everything that a device file may state, in its order."""
    for name, table in TABLES.items():
        for key in table.model_fields:
            yield f"{name}.{key}"


def value_of(device: DeviceFile, key: str) -> Any:
    """Value of a device at a key like `encoder.count_m`."""
    table, _, name = key.partition(".")
    return getattr(getattr(device, table), name)


def examples() -> dict[str, Path]:
    """The built-in examples by name."""
    return {path.stem: path for path in sorted(EXAMPLES.glob("*.toml"))}


def find(named: str | None, library: Path | None = None) -> Described:
    """The device that a command refers to.

    Parameters
    ----------
    named : a file, or a built-in example; None looks for `device.toml` beside the library.
    library : the file, None without one.

    Raises
    ------
    InputError : the file cannot be read or is not a valid device file.
    """
    if named is not None:
        example = examples().get(named)
        if example is not None and not is_file(Path(named)):
            return _described(example, None, f"built-in example {named}")
        if not is_file(Path(named)) and Path(named).suffix != ".toml":
            names = examples()
            raise InputError(
                f"--device {named}: no such file{did_you_mean(named, names)}; give a device file or one of the "
                f"built-in examples {', '.join(names)}"
            )
        return read_device(Path(named))
    if library is not None and is_file(library.parent / BESIDE):
        return read_device(library.parent / BESIDE)
    return Described(BUILT_IN, None, "the built-in one", frozenset())


def read_device(path: Path) -> Described:
    """The device of a device file."""
    return _described(path, path, str(path))


def _described(path: Path, kept: Path | None, source: str) -> Described:
    content = read_toml(path, ADVICE)
    if OF_A_CIRCUIT in content:
        made = f"`transopt-play device circuit {path}` writes offered.toml beside it: give that"
        raise InputError(f"{path}: a circuit file, no device file: {made}")
    device = section_of(path, content, DeviceFile)
    stated = frozenset(f"{table}.{key}" for table in TABLES for key in content.get(table, {}))
    return Described(device, kept, source, stated)


def as_text(device: DeviceFile, head: str = "") -> str:
    """A device file with a comment at each key.

    Parameters
    ----------
    head : comment lines at the top, without `#`.
    """
    lines = [f"# {line}" for line in head.splitlines()]
    lines += [f"name = {toml_value(device.name)}"]
    for table, kind in TABLES.items():
        lines += ["", f"[{table}]  # {(kind.__doc__ or '').splitlines()[0]}"]
        for key, field in kind.model_fields.items():
            value = getattr(getattr(device, table), key)
            shown = f"# {key} =" if value is None else f"{key} = {toml_value(value)}"
            lines.append(f"{shown}  # {field.description}")
    return "\n".join(lines) + "\n"


def write_device(path: Path, device: DeviceFile, head: str = "") -> None:
    """Write a new device file.

    Raises
    ------
    InputError : the file exists or cannot be written.
    """
    if path.exists():
        raise InputError(f"{path}: is there already; choose another name, or change it in an editor")
    _write(path, as_text(device, head))


def restate(path: Path, key: str, value: float) -> None:
    """Change the value of one key in a device file; all other lines and comments stay unchanged.

    Parameters
    ----------
    key : like `encoder.surface_counts`.

    Raises
    ------
    InputError : the file cannot be read or written, or its layout does not allow the change.
    """
    before = read_text(path, ADVICE)
    parse_toml(before, path, ADVICE)
    text = edited(before, {key: value}, noted=False)
    if text is None:
        table, _, name = key.partition(".")
        raise InputError(
            f"{path}: write {name} = {value!r} into its table [{table}] by hand; it is laid out unusually"
        )
    _write(path, text)


def _write(path: Path, text: str) -> None:
    try:
        with whole_file(path) as file:
            file.write(text.encode("utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose another place") from None
