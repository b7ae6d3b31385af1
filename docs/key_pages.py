"""Tables of the keys that a scene and a device file may state, written from the code."""

import tomllib
from collections.abc import Iterator
from typing import Any, get_args

from page_tables import code, table
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from controller.device.device_file import BUILT_IN, TABLES
from controller.device.reading import all_keys, value_of
from transopt.base.section import Section, meanings
from transopt.base.units import unit_of
from transopt.plant.hand import LinearParameter
from transopt.plant.kinds import Model
from transopt.plant.motor import Motor
from transopt.scene.builtin import SCENES
from transopt.scene.keys import bounds_of, flat
from transopt.scene.scene import Scene

NOT_STATED = ("kind", "striker")  # the heading of a section has the one; nobody writes the other into a file
# Keys that no built-in scene states, or states at length, and that have no default.
EXAMPLES: dict[str, object] = {
    "name": "oak_5_N",
    "description": "oak, 5 N",
    "time.stages": 800,
    "grid.cool_share": 0.36,
    "time.lead_s": 3e-4,
    "recordings.simulated.grip_N": 3.0,
    "recordings.columns": ["time_s", "-", "acceleration_g"],
    "recordings.units": {"acc": "g"},
    "recordings.full_scale_m_s2": 490.3,
    "recordings.channel": 2,
    "recordings.rate_Hz": 3200,
    "recordings.axis": "main",
    "recordings.taps_by_file": {"session.csv": [1, 3]},
    "recordings.speed_m_s": 0.2,
    "recordings.speed_by_file_m_s": {"slow.wav": 0.1},
    "recordings.grip_N": 3.0,
    "targets.decay_s": 3e-3,
    "targets.file": "click.csv",
    "targets.length_s": 0.02,
    "model.nonlinear.force_factor": "BL*(1 - 0.3*(x/0.6e-3)**2)",
    "model.nonlinear.stiffness": "K*(1 + 0.5*(x/0.6e-3)**2)",
    "model.nonlinear.friction": "0.04*tanh(v/5e-3)",
    "model.file": "plant.npz",
    "model.outputs.row": [1.0, 0.0],
    "model.outputs.unit": "m",
    "model.outputs.follows": "position",
    "model.winding.R_wh_K_W": 3.1,
    "model.winding.R_ha_K_W": 14.0,
    "model.winding.tau_w_s": 12.4,
    "model.winding.tau_h_s": 612.0,
    "model.winding.winding_max_C": 100.0,
    "model.motor_shares": [1.0, 1.0, 0.8],
    "motor.R_eddy_ohm": 34.0,
    "tip.force_per_current_N_A": 1.25,
    "tip.moving_mass_kg": 0.014,
    "tip.stiffness_N_m": 6e4,
    "tip.damping_N_s_m": 8.0,
    "amplifier.switching_Hz": 22.5e3,
    "amplifier.gain_V_A": 1.2,
    "limits.current_A": 4.0,
    "limits.slew_A_per_s": 2e4,
    "limits.slew_V_per_s": 1e4,
    "limits.velocity_m_s": 0.42,
    "limits.own": ["my_limits.py"],
    "thermal.idle_A": 0.1,
    "robust.grip_spread": 0.2,
    "robust.model_uncertainty": True,
    "robust.population": "populations/stylus_grip.toml",
    "robust.resonance_spread": 0.04,
    "robust.quality_spread": 0.25,
}


def scene_tables(section: type[Section], path: str) -> Iterator[tuple[str, type[Section]]]:
    """The tables that a scene file may have, by their dotted paths: every kind of model, and the file of a motor."""
    yield path, section
    for name, field in section.model_fields.items():
        inner = [part for part in flat(field.annotation) if isinstance(part, type) and issubclass(part, Section)]
        if path == "" and name == "model":
            inner = [part for part in flat(Model) if isinstance(part, type) and issubclass(part, Section)]
        if name not in (*NOT_STATED, "own", "population"):  # files in a scene, read into tables
            for each in dict.fromkeys(one for one in inner if one is not LinearParameter):
                yield from scene_tables(each, f"{path}.{name}" if path else name)


def scene_keys() -> str:
    """A section for each table of a scene, with a sentence, the unit and an example for every key."""
    stated = [tomllib.loads(path.read_text(encoding="utf-8")) for path in sorted(SCENES.glob("*.toml"))]
    for table_of, file in (
        ("motor", "motors/maxon_re25_118743.toml"),
        ("transmission", "transmissions/rigid_rod.toml"),
    ):
        stated.append({table_of: tomllib.loads((SCENES.parent / file).read_text(encoding="utf-8"))})
    head = ["key", "unit", "what it is", "default", "allowed", "example"]
    sections: dict[str, str] = {}
    tables = list(scene_tables(Scene, ""))
    not_keys = {*NOT_STATED, *(path for path, _ in tables)}
    for path, section in tables:
        rows = [
            [code(f"{path}.{name}".strip(".")), unit_of(name), *_about(section, path, name, field, stated)]
            for name, field in section.model_fields.items()
            if name not in NOT_STATED and f"{path}.{name}".strip(".") not in not_keys
        ]
        if rows:
            kind = section.model_fields.get("kind")
            title = (f"`{path}`" if path else "Above the first table") + (
                f', kind `"{get_args(kind.annotation)[0]}"`' if kind else ""
            )
            words = " ".join((section.__doc__ or "").split("Attributes")[0].split())
            file = "A motor's file states these; a scene names the file.\n\n" if section is Motor else ""
            sections.setdefault(title, f"## {title}\n\n{words}\n\n{file}{table(head, rows)}")
    return "\n\n".join(sections.values())


def _about(
    section: type[Section], path: str, name: str, field: FieldInfo, stated: list[dict[str, Any]]
) -> tuple[str, str, str, str]:
    """What a key is, its default, what it may be, and an example: of a built-in scene where one states it."""
    key, parts = f"{path}.{name}".strip("."), [*flat(field.annotation), *field.metadata]
    parts += [bound for part in parts if isinstance(part, FieldInfo) for bound in part.metadata]
    words = [word for part in parts for word in get_args(part) if isinstance(word, str) and word]
    numeric = float in parts or int in parts
    allowed = " or ".join(
        filter(None, [bounds_of(parts, unit_of(name)) if numeric else "", ", ".join(map(code, words))])
    )
    usual = None if field.default is PydanticUndefined else field.default
    default = "the file's" if key == "name" else "to be stated" if field.is_required() else shown(usual)
    said = meanings(section)[name]
    examples = [EXAMPLES.get(key), *(_stated(scene, key.split(".")) for scene in stated), usual]
    return said[0].upper() + said[1:], default, allowed, code(toml(next(one for one in examples if one is not None)))


def _stated(content: Any, path: list[str]) -> Any:
    for part in path:
        content = content[0] if isinstance(content, list) and content else content
        content = content.get(part) if isinstance(content, dict) else None
    return content


def toml(value: object) -> str:
    """A value as a line of TOML states it, without the rest of a long list."""
    match value:
        case bool():
            return str(value).lower()
        case str():
            return f'"{value}"'
        case float():
            return f"{value:g}"
        case list():
            return f"[{', '.join(map(toml, value[:4]))}{', ...' if len(value) > 4 else ''}]"
        case dict():
            return "{ " + ", ".join(f'"{name}" = {toml(one)}' for name, one in value.items()) + " }"
    return str(value)


def shown(value: object) -> str:
    return "" if value is None or value == "" else code(toml(value))


def device_keys() -> str:
    """Every key of a device file with unit, the value of the built-in device, and a sentence."""
    rows = []
    for key in all_keys():
        section, _, name = key.partition(".")
        rows.append(
            [code(key), unit_of(key), shown(value_of(BUILT_IN, key)), TABLES[section].model_fields[name].description]
        )
    return table(["key", "unit", "built-in", "what it is"], rows)
