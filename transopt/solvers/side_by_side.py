"""Searches that ask for solutions on their way, carried on together: what they ask for is answered side by side.

A search is a generator. It yields an `Ask`, is sent the answer, and returns what it has found:

    def optimum_of(problem: TransientProblem) -> Search[Solution]:
        free = yield Ask(unlimited.solve, problem)
        ...

Alone it reads as it runs. Of many that `together` carries on, all that ask the same method wait for one call of it.
"""

from collections.abc import Callable, Generator, Sequence
from typing import Any, NamedTuple, TypeVar

Found = TypeVar("Found")


class Ask(NamedTuple):
    """One question to a method that answers any number of them at once, method(list of `of`, *settings) -> list."""

    method: Callable[..., list[Any]]
    of: Any
    settings: tuple[Any, ...] = ()


Search = Generator[Ask, Any, Found]


def alone(search: Search[Found]) -> Found:
    """Carry on one search.

    Raises
    ------
    Exception : whatever the search, or a method that it asks, raises.
    """
    return together([search])[0]


def together(searches: Sequence[Search[Found]]) -> list[Found]:
    """Carry on searches until all have ended.

    An exception of a method is raised in the search whose question it could not answer, and in no other.

    Returns
    -------
    What the searches have found, in their order.

    Raises
    ------
    Exception : whatever a search raises.
    """
    found = dict[int, Found]()
    asked = dict[int, Ask]()

    def carry_on(number: int, answer: Any) -> None:
        search = searches[number]
        try:
            asked[number] = search.throw(answer) if isinstance(answer, Exception) else search.send(answer)
        except StopIteration as ended:
            found[number] = ended.value

    for number in range(len(searches)):
        carry_on(number, None)
    while asked:
        # The question that most ask is answered first: others may come to ask it too.
        groups: dict[tuple[Any, ...], list[int]] = {}
        for number, ask in asked.items():
            groups.setdefault((ask.method, *ask.settings), []).append(number)
        (method, *settings), numbers = max(groups.items(), key=lambda group: len(group[1]))
        answers = _answers(method, [asked.pop(number).of for number in numbers], settings)
        for number, answer in zip(numbers, answers, strict=True):
            carry_on(number, answer)
    return [found[number] for number in range(len(searches))]


def _answers(method: Callable[..., list[Any]], of: list[Any], settings: Sequence[Any]) -> list[Any]:
    """Answers to questions; an exception in the place of those that have none."""
    try:
        return method(of, *settings)
    except Exception as error:
        if len(of) == 1:
            return [error]
    # Which of them it is is found by asking one by one.
    return [answer for each in of for answer in _answers(method, [each], settings)]
