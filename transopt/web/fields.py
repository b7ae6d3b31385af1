"""Refusals in the words of the page: keys of the scene become names of sliders, options names of fields."""

import re
from dataclasses import dataclass
from typing import Any

from transopt.base.units import unit_of, words_of
from transopt.files.unclear import Answer
from transopt.web.service import Service

# Wording for the command line and Python -> wording for the page.
ELSEWHERE = (
    (r"--accept takes it, or recordings\.implausible = \"accept\" in the scene", 'tick "take numbers as they are"'),
    (r", and no scene does, recordings\.speed_by_file_m_s = .*\}", ""),
    (r"(--|recordings\.)speed(_m_s)?\b", 'the field "speed where a file states none"'),
    (r"the motor's i_peak_A = ", "the motor's peak current of "),
    (r"--recordings( FOLDER)?", "the option --recordings of transopt page"),
)


@dataclass(frozen=True)
class Refusal:
    """A refusal in the words of the page.

    Attributes
    ----------
    words : text for the page.
    key : key of the slider concerned; empty for none or several.
    """

    words: str
    key: str


def in_words(words: str, service: Service | None) -> Refusal:
    """A message of the project in the words of the page's own fields."""
    key = ""
    if service is not None:
        words = words.removeprefix(f"{service.opened.name}: ")
        for control in sorted(service.controls, key=lambda each: -len(each.key)):
            if control.key in words:
                key = key or control.key
                stated = f"{control.label} = \\1 {control.unit}".rstrip()
                words = re.sub(rf"{re.escape(control.key)} = (-?[0-9.e+]+)", stated, words)
                words = words.replace(control.key, control.label)
    for pattern, instead in ELSEWHERE:
        words = re.sub(pattern, instead, words)
    return Refusal(words, key)


def choice(answer: Answer) -> str:
    """An answer to what a file leaves open, in the words of a button."""
    return ", ".join(_stated(key, value) for key, value in answer.items())


def _stated(key: str, value: Any) -> str:
    match key:
        case "units":
            return ", ".join(f"{name} in {unit.replace(' @ ', ' at ')}" for name, unit in value.items())
        case "columns":
            return f"columns {', '.join(value)}"
        case "implausible":
            return "the numbers are right"
        case _:
            unit = unit_of(key)
            return f"{words_of(key)} {value:g} {unit}".rstrip() if unit else f"{words_of(key)} {value}"
