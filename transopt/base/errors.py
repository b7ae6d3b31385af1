"""The one exception that a user can cause, and suggestions for an unknown word in its message."""

import difflib
from collections.abc import Iterable

MOST = 3  # suggestions


class InputError(ValueError):
    """Something the user gave cannot be used.

    The message is one line: where, which field, its value with unit, the limit, and what to do next.
    The command line prints it without a traceback and exits with 2.
    """


def nearest(word: str, known: Iterable[str], cutoff: float = 0.6) -> list[str]:
    """The known words most similar to this one, best first: those that begin with it, then those of similar spelling.

    Parameters
    ----------
    cutoff : least similarity, 0 to 1, as in `difflib.get_close_matches`.
    """
    spelt = {known_word.lower(): known_word for known_word in known}
    typed = word.lower()
    begin = [low for low in spelt if len(typed) > 1 and low.startswith(typed)]
    like = difflib.get_close_matches(typed, spelt, MOST, cutoff)
    return [spelt[low] for low in dict.fromkeys([*begin, *like])][:MOST]


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """` (did you mean this or that?)`, to be appended to an unknown word; empty if no known word is similar."""
    found = nearest(word, known)
    return f" (did you mean {' or '.join(found)}?)" if found else ""
