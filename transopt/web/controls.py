"""The sliders and choices of the page, derived from the scene's keys.

Keys, units, bounds and defaults come from `transopt.scene.keys`, which reads the tables of a scene, so a new limit of
the project gets its slider without a change here. Whether the scene accepts a key is determined by setting it.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from transopt.base.errors import InputError
from transopt.base.section import Section
from transopt.base.units import words_of
from transopt.plant.state_space import Input
from transopt.problem.limits import kinds_of
from transopt.scene.keys import Key, Value, keys, with_values
from transopt.scene.scene import Scene

TABLES = ("limits", "thermal", "feedback", "weights", "robust", "amplifier")  # tables with sliders, in page order
DEVICE = ("amplifier.pole_Hz", "amplifier.delay_s")  # properties of the device, not offered as sliders
DECADE = 10.0  # a slider reaches from a tenth to ten times the present value
HALVINGS = 10  # bisection steps for the end of a slider that the scene still accepts
# Typical values by unit: the middle of the slider of a limit that the scene does not state; 1 for other units.
USUAL = {
    "A": 2.0,
    "A/s": 1e4,
    "V": 10.0,
    "V/s": 1e5,
    "m": 1e-3,
    "m/s": 0.3,
    "K": 0.1,
    "Hz": 2.0,
    "N/m": 200.0,
    "N s/m": 1.0,
    "": 0.1,
}


@dataclass(frozen=True)
class Control:
    """One number or choice of a scene that can be changed on the page.

    Attributes
    ----------
    key : dotted key of the scene.
    label : name on the page: the label of its limit, or the words of the key.
    table : table of the scene that contains it.
    unit : empty without one.
    value : value in the scene or its default; None if it is not stated.
    low, high : ends of the slider; zero for a choice.
    start : position of the slider when it is switched on.
    log : whether the slider is logarithmic.
    integer : whether only integers are accepted.
    optional : whether it can be left out.
    choices : permitted words; empty for a number.
    bounds : permitted range in words.
    about : description of the table.
    """

    key: str
    label: str
    table: str
    unit: str
    value: Value
    low: float
    high: float
    start: float
    log: bool
    integer: bool
    optional: bool
    choices: tuple[str, ...]
    bounds: str
    about: str

    def at(self, share: float) -> float:
        """The value at a share, 0 to 1, of the slider."""
        value = self.low * (self.high / self.low) ** share if self.log else self.low + share * (self.high - self.low)
        rounded = round(value) if self.integer else float(f"{value:.3g}")
        return min(max(rounded, self.low), self.high)


def input_key(scene: Scene) -> str:
    """The key of the transient limit on the plant's input, which the plots show."""
    return "limits.current_A" if scene.driven_by.unit == "A" else "limits.voltage_V"


def following(scene: Scene) -> dict[str, float]:
    """Key -> effective value of limits that follow from others: the transient one, its ratio to the steady one."""
    limits = scene.limits
    found = {input_key(scene): limits.transient_input}
    if scene.driven_by.unit == "A":
        found["limits.beta"] = float(f"{limits.transient_input / limits.steady_input:.6g}")
    return found


def controls(scene: Scene) -> list[Control]:
    """All controls of the page, table by table."""
    found = [control for key in keys(scene) if (control := _control(scene, key)) is not None]
    return sorted(found, key=lambda control: TABLES.index(control.table))


def at_present(found: Sequence[Control], scene: Scene) -> list[Control]:
    """Controls with the values of a changed scene; a slider makes room for a value beyond its ends."""
    now = {key.path: _now(scene, key) for key in keys(scene)}
    return [_holding(control, now[control.key]) for control in found]


def _holding(control: Control, value: Value) -> Control:
    if control.choices or not isinstance(value, int | float) or (control.log and value <= 0):
        return replace(control, value=value)
    return replace(control, value=value, low=min(control.low, value), high=max(control.high, value))


def _control(scene: Scene, key: Key) -> Control | None:
    """A key's control; None for a key that is not in `TABLES` or that the scene does not accept."""
    table = key.path.split(".", 1)[0]
    if table not in TABLES or key.path.count(".") != 1 or key.path in DEVICE or not (key.number or key.choices):
        return None
    if not isinstance(getattr(scene, table), Section):  # no wall and no spread to change, or an ideal amplifier
        return None
    if table == "amplifier" and key.unit != scene.driven_by.unit:
        return None
    value = _now(scene, key)
    choices = key.choices or (tuple(map(str, _whole(key))) if "one of" in key.bounds else ())
    low, high, log = (0.0, 0.0, False) if choices else _range(key, value)
    start = float(value) if isinstance(value, int | float) else _usual(key, low, high)
    control = Control(
        key=key.path,
        label=_label(key.path, scene.driven_by),
        table=table,
        unit=key.unit,
        value=value,
        low=low,
        high=high,
        start=start,
        log=log,
        integer=key.integer,
        optional=key.optional and not _needed(scene, key.path),
        choices=choices,
        bounds=key.bounds,
        about=key.description,
    )
    if choices:
        return control if any(_takes(scene, key.path, parsed(word)) for word in choices) else None
    if value is None:
        return control if _takes(scene, key.path, control.at(_share(control, start))) else None
    ends = (_end(scene, control, high), _end(scene, control, low))
    return None if ends[0] == ends[1] else replace(control, low=ends[1], high=ends[0])


def parsed(word: str) -> Value:
    """The value of a choice's word for the scene; integers are converted."""
    return int(word) if word.isdigit() else word


def _share(control: Control, value: float) -> float:
    """Position of a value on the slider, 0 to 1."""
    if control.log:
        return math.log(value / control.low) / math.log(control.high / control.low)
    return (value - control.low) / (control.high - control.low)


def _takes(scene: Scene, path: str, value: Value) -> bool:
    """Whether the scene accepts a value."""
    try:
        with_values(scene, {path: value})
    except InputError:
        return False
    return True


def _end(scene: Scene, control: Control, end: float) -> float:
    """The end of a slider, reduced to a value that the scene accepts, such as the motor's peak current."""
    inside, outside = _share(control, control.start), _share(control, end)
    if _takes(scene, control.key, control.at(outside)):
        return control.at(outside)
    for _ in range(HALVINGS):
        middle = (inside + outside) / 2
        if _takes(scene, control.key, control.at(middle)):
            inside = middle
        else:
            outside = middle
    found = control.at(inside)
    return found if _takes(scene, control.key, found) else control.start


def _now(scene: Scene, key: Key) -> Value:
    """The effective value of a key."""
    followed = following(scene)
    if key.path in followed:
        return followed[key.path]
    stated = key.value
    if stated is None and not key.optional and getattr(scene, key.path.split(".", 1)[0]) is not None:
        return key.default
    return stated


def _needed(scene: Scene, path: str) -> bool:
    """Whether the scene's table requires the key, although the table itself is optional."""
    needed = {input_key(scene), "limits.beta"}
    return path in needed or (path == "limits.steady_current_A" and scene.driven_by.unit == "A")


def _whole(key: Key) -> Iterator[int]:
    low, high = key.interval
    return iter(range(int(low), int(high) + 1))


def _usual(key: Key, low: float, high: float) -> float:
    usual = min(max(USUAL.get(key.unit, 1.0), low), high)
    return round(usual) if key.integer else usual


def _range(key: Key, value: Value) -> tuple[float, float, bool]:
    """Ends of the slider, a decade around the value and within the key's bounds, and whether it is logarithmic."""
    least, most = key.interval
    centre = float(value) if isinstance(value, int | float) else USUAL.get(key.unit, 1.0)
    if key.unit in ("C", "dB"):  # an arbitrary zero: ratios have no meaning
        return max(least, min(centre, 0.0) - 20), min(most, centre + 60), False
    if centre > 0 and least >= 0:
        low, high = max(centre / DECADE, least), min(centre * DECADE, most)
        if key.path == "weights.calm" or (least == 1 and not key.integer):
            low, high = 1.0, min(max(centre * DECADE, 100.0), most)
        if 0 < low < high:
            return float(f"{low:.3g}"), _below(high, most), not key.integer
    span = USUAL.get(key.unit, 1.0)
    low = max(least, 0.0) if least >= 0 else -span
    return low, min(low + 2 * span, most), False


def _below(high: float, most: float) -> float:
    """The upper end of a slider, rounded, strictly below a bound."""
    return float(f"{(high if high < most else most * (1 - 1e-3)):.3g}")


def _label(path: str, driven_by: Input) -> str:
    """A limit's own label, or the words of its key without the unit."""
    table, name = path.split(".", 1)
    if table == "limits":
        of_kind = next((kind.label for kind in kinds_of(driven_by) if kind.key == name), None)
        if of_kind is not None:
            return of_kind
    return WORDS.get(path, words_of(name))


WORDS = {
    "limits.beta": "transient limit over the steady one",
    "limits.steady_current_A": "steady current",
    "weights.rho": "weight of the command's movement",
    "weights.plain": "weight of the error as it is",
    "weights.rapid": "filter of the rapid error",
    "weights.rapid_from_Hz": "rapid errors are weighed from",
    "weights.calm": "weight of what rings afterwards",
    "weights.after_s": "time after the waveform that counts",
    "amplifier.command_limit_A": "command",
    "amplifier.command_limit_V": "command",
}
