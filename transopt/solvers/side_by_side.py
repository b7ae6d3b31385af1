"""Run several searches concurrently, so that the problems that they need solved are solved in one call.

A search is a generator (coroutine). It yields an `Ask`, is sent the answer, and returns its result:

    def optimum_of(problem: TransientProblem) -> Search[Solution]:
        free = yield Ask(unlimited.solve, problem)
        ...

The code of a search reads as if it ran alone. `together` runs many: it collects the questions to the same method and
answers them in one call.
"""

from collections.abc import Callable, Generator, Sequence
from typing import Any, NamedTuple, TypeVar

Found = TypeVar("Found")


class Ask(NamedTuple):
    """One question to a batch method: method(list of all `of`, *settings) -> list of answers."""

    method: Callable[..., list[Any]]
    of: Any
    settings: tuple[Any, ...] = ()


Search = Generator[Ask, Any, Found]


def alone(search: Search[Found]) -> Found:
    """Run one search to its end.

    Raises
    ------
    Exception : any exception of the search, or of a method that it asks.
    """
    return together([search])[0]


def together(searches: Sequence[Search[Found]]) -> list[Found]:
    """Run searches until all have ended.

    An exception of a method is raised only inside the search whose question caused it.

    Returns
    -------
    The results of the searches, in their order.

    Raises
    ------
    Exception : any exception that a search does not catch.
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
        # The most frequent question is answered first.
        groups: dict[tuple[Any, ...], list[int]] = {}
        for number, ask in asked.items():
            groups.setdefault((ask.method, *ask.settings), []).append(number)
        (method, *settings), numbers = max(groups.items(), key=lambda group: len(group[1]))
        answers = _answers(method, [asked.pop(number).of for number in numbers], settings)
        for number, answer in zip(numbers, answers, strict=True):
            carry_on(number, answer)
    return [found[number] for number in range(len(searches))]


def _answers(method: Callable[..., list[Any]], of: list[Any], settings: Sequence[Any]) -> list[Any]:
    """Answers to questions; a question that raises an exception has that exception as its answer."""
    try:
        return method(of, *settings)
    except Exception as error:
        if len(of) == 1:
            return [error]
    # Ask one by one, to find the question that causes the exception.
    return [answer for each in of for answer in _answers(method, [each], settings)]
