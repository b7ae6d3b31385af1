"""Answers to a question about a file, tried on the file: those with which it can be read are proposed.

Only the user knows which answer is right, so none is applied without being asked. The most usual tap comes first.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.files.formats import full_scales
from transopt.files.unclear import Answer, UnclearError, joined, keys, options, printable, shown_path
from transopt.files.units import UNITS, known_units, read_unit, sensed
from transopt.recordings.plausible import PEAK_G, USUAL_SPEED_CHANGE, speed_changes_m_s
from transopt.recordings.settings import Recordings
from transopt.recordings.tap import PreparedTap, check_speed, prepare, read_recordings

Found = TypeVar("Found")
Taps = tuple[list[PreparedTap], Recordings]
MOST_NAMED = 3  # most answers in a line
MOST_LISTED = 9  # most answers on a terminal
MOST_TRIALS = 80
TRIAL_S = 2.0  # processor time after which no further answer is tried
DEEPEST = 3  # most facts that a file may lack at the same time
USUAL_RATE_HZ = (400.0, 300e3)  # sample rates of accelerometers and their recorders
UNLIKELY = 0.1  # added to `oddness` per place in a list of answers, which begins with the likeliest
MISTAKEN = ("acceleration", "time", "position", "grip")  # quantities whose wrong units make a tap implausible


class Trials(NamedTuple):
    """Answers that were tried on a file.

    Attributes
    ----------
    good : answers with which the file can be read, the likeliest first, each with a description of the result.
    refused : why the likeliest answer failed, if the file can be read with none.
    """

    good: list[tuple[Answer, str]]
    refused: str = ""


class AskedError(InputError):
    """Files leave a fact open; only the user knows which of the answers that were tried on them is right.

    Attributes
    ----------
    problem : what is unknown, one sentence that begins with the file's name.
    good : as `Trials.good`.
    """

    def __init__(self, unclear: UnclearError, tried: Trials) -> None:
        super().__init__(in_a_line(unclear, tried))
        name = None if unclear.file is None else Path(unclear.file.name)
        self.problem, self.good = printable(f"{shown_path(name)}{unclear.problem}"), tried.good


def trials(
    read: Callable[[Answer], Found],
    describe: Callable[[Found], str],
    doubt: Callable[[Found], UnclearError | None],
    odd: Callable[[Found], float],
    unclear: UnclearError,
    stated: Answer,
) -> Trials:
    """The answers with which the file can be read; implausible ones only if no other is found.

    Parameters
    ----------
    read : reads the file with an answer. describe : describes a result. doubt : the question that a result raises, or
        None.
    odd : distance of a result from a usual tap. unclear : the question.
    stated : what is stated already; a proposal that adds units repeats the units in it.
    """
    good = list[tuple[float, Answer, str]]()
    doubtful = list[tuple[float, Answer, str]]()
    refused = list[str]()
    until, count = time.process_time() + TRIAL_S, 0

    def follow(question: UnclearError, before: Answer, depth: int, unlikely: float) -> None:
        nonlocal count
        for place, each in enumerate(question.answers):
            count += 1
            if count > MOST_TRIALS or time.process_time() > until:
                return
            answer = joined(before, each)
            try:
                found = read(joined(stated, answer))
            except UnclearError as more:
                if depth < DEEPEST and more.answers != question.answers:
                    follow(more, answer, depth + 1, unlikely + UNLIKELY * place)
            except InputError as error:
                refused.append(f"with {options(answer)}: {error}")
            else:
                doubted = doubt(found)
                is_good = doubted is None or "implausible" not in doubted.answers[-1]
                words = describe(found) if is_good else f"{describe(found)}; implausible"
                # If an option is given twice, the last one counts, so a proposal has to repeat all stated units.
                whole = {**answer, "units": joined(stated, answer)["units"]} if "units" in answer else answer
                if not is_good:
                    whole = {**whole, "implausible": "accept"}
                (good if is_good else doubtful).append(
                    (round(odd(found) + unlikely + UNLIKELY * place, 1), whole, words)
                )

    follow(unclear, {}, 1, 0.0)
    best = sorted(good or doubtful, key=lambda one: one[0])
    return Trials([(answer, words) for _, answer, words in best[:MOST_LISTED]], next(iter(refused), ""))


def in_a_line(unclear: UnclearError, tried: Trials, form: Callable[[Answer], str] = options) -> str:
    """The question with the answers that were tried on the file, as options or as a scene's `keys`."""
    lead = f"{shown_path(unclear.file)}{unclear.problem}"
    if not tried.good:
        refused = tried.refused.replace(shown_path(unclear.file), "") or "no answer was tried in time"
        return printable(f"{lead}; nothing that is usual for it reads the file, {refused}")
    named = " or ".join(f"{form(answer)} ({words})" for answer, words in tried.good[:MOST_NAMED])
    return printable(f"{lead}; tried on it, of which only you know the right one: {named}")


def prepared(settings: Recordings) -> Taps:
    """The taps of recordings, prepared for references, and the settings."""
    return [prepare(recording, settings) for recording in read_recordings(settings)], settings


def summary(found: Taps) -> str:
    """A short description of what was read."""
    first, *more = found[0]
    others = f", and {len(more)} taps more" if more else ""
    peak_g = first.peak_m_s2 / STANDARD_GRAVITY_M_S2
    changed = ""
    if first.speed_m_s > 0:
        ratio = speed_changes_m_s(first.acceleration, 0.0)[0] / first.speed_m_s
        changed = f", a change of speed by {ratio:.2g} times the incoming {first.speed_m_s:.3g} m/s"
    return f"{first.recording.acceleration.rate_Hz / 1e3:.4g} kHz, a peak of {peak_g:.3g} g{changed}{others}"


def oddness(found: Taps) -> float:
    """Distance of taps from usual ones: the logarithm of the speed change's ratio, plus 1 per bound exceeded."""
    taps = found[0]
    ratios = [speed_changes_m_s(tap.acceleration, 0.0)[0] / tap.speed_m_s for tap in taps if tap.speed_m_s > 0]
    off = float(np.max(np.abs(np.log(np.maximum(ratios, 1e-300) / USUAL_SPEED_CHANGE)), initial=0.0))
    low, high = (each * STANDARD_GRAVITY_M_S2 for each in PEAK_G)
    is_high = any(not low <= tap.peak_m_s2 <= high for tap in taps)
    is_fast = any(not USUAL_RATE_HZ[0] <= tap.recording.acceleration.rate_Hz <= USUAL_RATE_HZ[1] for tap in taps)
    return off + is_high + is_fast


def doubt(found: Taps) -> UnclearError | None:
    """The question if taps are implausible, with units, full scales and speeds to try; None if all are plausible."""
    taps, settings = found
    odd = next((tap for tap in taps if tap.implausible), None)
    if odd is None or settings.implausible == "accept":
        try:
            for tap in taps:
                check_speed(tap)  # a scene needs the speed
        except UnclearError as error:
            return error
        return None
    if odd.implausible.startswith("clipped"):  # whatever the units are
        return UnclearError(odd.implausible, [{"implausible": "accept"}], Path(odd.recording.source))
    # The key under which the user states the unit of a quantity, or the quantity itself.
    stated = {
        of: next((pair for pair in settings.units.items() if read_unit(pair[1], of)), (of, "")) for of in MISTAKEN
    }
    answers: list[Answer] = [
        {"units": {key: each}}
        for of, (key, unit) in stated.items()
        for each in (sensed(unit.partition("@")[0].strip()) if "@" in unit else known_units(of))
    ]
    if settings.full_scale_m_s2 is not None:
        answers += full_scales()
    if settings.speed_m_s is not None:
        answers += [{"speed_m_s": float(f"{by * settings.speed_m_s:.4g}")} for by in (1e-2, 1e-3)]
    if settings.grip_N is not None:
        answers += [{"grip_N": float(f"{UNITS['grip'][unit] * settings.grip_N:.4g}")} for unit in ("gf", "mN")]
    answers.append({"implausible": "accept"})
    return UnclearError(odd.implausible, answers, Path(odd.recording.source))


def usable(read: Callable[[Answer], Taps]) -> Taps:
    """The taps, if a library may be made from them.

    Raises
    ------
    AskedError : the file leaves a fact open, or holds no plausible tap.
    InputError : the file cannot be read.
    """
    try:
        found = read({})
    except UnclearError as error:
        raise AskedError(error, trials(read, summary, doubt, oddness, error, {})) from None
    if (refused := refusal(found, read)) is not None:
        raise refused
    return found


def asked_in_scene(unclear: UnclearError, settings: Recordings) -> InputError:
    """The question that a scene's files leave open, with the scene's keys that were tried on them."""

    def read(answer: Answer) -> Taps:
        return prepared(Recordings.model_validate(joined(settings.model_dump(), answer)))

    tried = trials(read, summary, doubt, oddness, unclear, {"units": settings.units})
    return InputError(in_a_line(unclear, tried, keys))


def refusal(found: Taps, read: Callable[[Answer], Taps]) -> AskedError | None:
    """Why no library should be made from these taps, with the options that were tried; None if one may be."""
    question = doubt(found)
    if question is None:
        return None
    return AskedError(question, trials(read, summary, doubt, oddness, question, {"units": found[1].units}))
