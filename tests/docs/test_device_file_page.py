"""The page on device files and the model of them cannot drift apart."""

from controller.device.device_file import BUILT_IN, TABLES
from controller.device.reading import all_keys, examples, value_of
from tests.benches.places import ROOT
from transopt.base.units import unit_of

PAGE = (ROOT / "docs/howto/device_file.md").read_text(encoding="utf-8")


def test_every_key_stands_in_the_table_with_its_unit_its_default_and_what_it_is() -> None:
    rows = [line for line in PAGE.splitlines() if line.startswith("| `") and "." in line.split("`")[1]]
    expected = []
    for key in all_keys():
        table, _, name = key.partition(".")
        value = value_of(BUILT_IN, key)
        default = (
            "" if value is None else f"`{str(value).lower() if isinstance(value, bool) else format(value, 'g')}`"
        )
        expected.append(f"| `{key}` | {unit_of(key)} | {default} | {TABLES[table].model_fields[name].description} |")
    assert [" ".join(row.split()) for row in rows] == [" ".join(row.split()) for row in expected]


def test_every_example_is_named() -> None:
    for name in examples():
        assert f"`--device {name}`" in PAGE
