"""Numbers that the code states with a unit: constants, defaults and bounds of keys, values of the built-in scenes."""

import ast
import re
from collections.abc import Iterator
from functools import cache

from tests.benches.places import ROOT

G = 9.80665
# Unit on a page -> quantity, and the factor to the unit in which that is compared.
UNITS = {
    **{"s": ("s", 1.0), "ms": ("s", 1e-3), "us": ("s", 1e-6), "µs": ("s", 1e-6)},
    **{"A": ("A", 1.0), "mA": ("A", 1e-3), "V": ("V", 1.0), "N": ("N", 1.0), "N/m": ("N/m", 1.0), "K": ("K", 1.0)},
    **{"°C": ("C", 1.0), "C": ("C", 1.0), "Hz": ("Hz", 1.0), "kHz": ("Hz", 1e3), "MHz": ("Hz", 1e6)},
    **{"m/s²": ("m/s²", 1.0), "m/s^2": ("m/s²", 1.0), "g": ("g", 1.0), "m/s": ("m/s", 1.0), "cm/s": ("m/s", 1e-2)},
    **{"m": ("m", 1.0), "mm": ("m", 1e-3), "um": ("m", 1e-6), "degrees": ("deg", 1.0), "°": ("deg", 1.0)},
    **{"bytes": ("B", 1.0), "kB": ("B", 2.0**10), "MB": ("B", 2.0**20), "cycles": ("cycles", 1.0)},
    **{"dB": ("dB", 1.0), "counts": ("counts", 1.0), "baud": ("baud", 1.0), "times": ("", 1.0)},
    **{"%": ("", 1e-2), "points": ("", 1e-2), "point": ("", 1e-2)},
}
# Ending of a name in the code -> the same.
ENDINGS = {
    **{
        "m_s2": ("m/s²", 1.0),
        "m_s": ("m/s", 1.0),
        "N_m": ("N/m", 1.0),
        "bytes": ("B", 1.0),
        "cycles": ("cycles", 1.0),
    },
    **{
        "us": ("s", 1e-6),
        "ms": ("s", 1e-3),
        "s": ("s", 1.0),
        "kHz": ("Hz", 1e3),
        "Hz": ("Hz", 1.0),
        "dB": ("dB", 1.0),
    },
    **{"A": ("A", 1.0), "V": ("V", 1.0), "N": ("N", 1.0), "K": ("K", 1.0), "C": ("C", 1.0), "g": ("g", 1.0)},
    **{"mm": ("m", 1e-3), "um": ("m", 1e-6), "m": ("m", 1.0), "deg": ("deg", 1.0), "counts": ("counts", 1.0)},
    **{"baud": ("baud", 1.0)},
}
NUMBER = r"-?\d+\.?\d*(?:[eE][+-]?\d+)?"
BOUNDS = ("default", "gt", "ge", "lt", "le")  # arguments of a key's field
OF_CONSTANTS = (ast.Constant, ast.BinOp, ast.UnaryOp, ast.operator, ast.unaryop)
Stated = tuple[str, float]


def quantity(name: str) -> tuple[str, float]:
    """Quantity and factor by the ending of a name in the code, such as `RESTS_S` and `pole_Hz`."""
    for ending, found in ENDINGS.items():
        if name.endswith(f"_{ending}") or (name.isupper() and name.endswith(f"_{ending.upper()}")):
            return found
    return "", 1.0


def _values(node: ast.AST | None) -> Iterator[float]:
    """Numbers that an expression of constants comes to, with those of a field's default and bounds."""
    if isinstance(node, ast.Call):
        for part in (*node.args, *(word.value for word in node.keywords if word.arg in BOUNDS)):
            yield from _values(part)
    elif isinstance(node, ast.Subscript):
        for word in ast.walk(node):
            if isinstance(word, ast.keyword) and word.arg in BOUNDS:
                yield from _values(word.value)
    elif isinstance(node, ast.Tuple | ast.List):
        for part in node.elts:
            yield from _values(part)
    elif isinstance(node, ast.expr) and all(isinstance(part, OF_CONSTANTS) for part in ast.walk(node)):
        value = eval(compile(ast.Expression(node), "", "eval"), {"__builtins__": {}})
        if isinstance(value, int | float) and not isinstance(value, bool):
            yield float(value)


def _named(node: ast.AST) -> Iterator[tuple[str, ast.AST | None]]:
    """Names of a statement, argument or dictionary, each with the expression of its value."""
    if isinstance(node, ast.Assign):
        for target in node.targets:
            if isinstance(target, ast.Name):
                yield target.id, node.value
            elif isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                pairs = zip(target.elts, node.value.elts, strict=False)
                yield from ((one.id, other) for one, other in pairs if isinstance(one, ast.Name))
    elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
        yield from ((node.target.id, part) for part in (node.value, node.annotation))
    elif isinstance(node, ast.keyword) and node.arg:
        yield node.arg, node.value
    elif isinstance(node, ast.arguments):
        last = node.args[len(node.args) - len(node.defaults) :]
        pairs = (*zip(last, node.defaults, strict=True), *zip(node.kwonlyargs, node.kw_defaults, strict=True))
        yield from ((argument.arg, default) for argument, default in pairs)
    elif isinstance(node, ast.Dict):
        for key, value in zip(node.keys, node.values, strict=True):
            if isinstance(key, ast.Constant) and isinstance(key.value, str):
                yield key.value.rsplit(".", 1)[-1], value


def _found() -> Iterator[Stated]:
    def of(name: str, value: float) -> Stated:
        kind, factor = quantity(name)
        return kind, abs(value * factor)

    for room in ("transopt", "controller", "problems"):
        for path in (ROOT / room).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                for name, value in _named(node):
                    yield from (of(name, each) for each in _values(value))
        for path in (ROOT / room).rglob("*.toml"):
            for name, values in re.findall(r"^(\w+) *= *([^#\n]+)", path.read_text(encoding="utf-8"), re.MULTILINE):
                yield from (of(name, float(each)) for each in re.findall(NUMBER, values))
        for ending in ("*.h", "*.c"):
            for path in (ROOT / room).rglob(ending):
                found = re.findall(rf"\b(\w+)(?: *=| ) *\(?({NUMBER})f?\b", path.read_text(encoding="utf-8"))
                yield from (of(name, float(each)) for name, each in found)


@cache
def stated() -> frozenset[Stated]:
    """Quantity and value, in the units of `UNITS`, of every named number of the code."""
    return frozenset(_found())


def is_stated(value: float, unit: str) -> bool:
    """Whether the code names this number with this unit."""
    kind, factor = UNITS[unit]
    wanted = {(kind, value * factor)}
    if kind == "B":
        wanted |= {(kind, value * 1e3), (kind, value * 1e6)}
    elif kind in ("g", "m/s²"):
        wanted |= {("m/s²", value * G), ("g", value / G)}
    return any(kind == other and abs(a - b) <= 1e-9 * abs(a) for kind, a in wanted for other, b in stated())
