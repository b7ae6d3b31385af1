"""The known word that was probably meant by one that is not known."""

import difflib
from collections.abc import Iterable

MOST = 3  # words that are offered


def nearest(word: str, known: Iterable[str], cutoff: float = 0.6) -> list[str]:
    """The known words most like this one, the likeliest first: those that begin with it, then those spelt like it.

    Parameters
    ----------
    cutoff : least likeness, 0 to 1, as of `difflib.get_close_matches`.
    """
    spelt = {known_word.lower(): known_word for known_word in known}
    typed = word.lower()
    begin = [low for low in spelt if len(typed) > 1 and low.startswith(typed)]
    like = difflib.get_close_matches(typed, spelt, MOST, cutoff)
    return [spelt[low] for low in dict.fromkeys([*begin, *like])][:MOST]


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """` (did you mean this or that?)`, to be put behind what is unknown; empty where no known word is near."""
    found = nearest(word, known)
    return f" (did you mean {' or '.join(found)}?)" if found else ""
