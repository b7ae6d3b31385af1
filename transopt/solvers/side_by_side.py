"""Searches that ask for solutions on their way, carried on together: what they ask for is answered side by side.

A search is a generator. It yields an `Ask`, is sent the answer, and returns what it has found:

    def optimum_of(problem: TransientProblem) -> Search[Solution]:
        free = yield Ask(unlimited.solve, problem)
        ...

Alone it reads as it runs. Of many that `together` carries on, all that ask the same method wait for one call of it.
"""

from collections.abc import Callable, Generator, Sequence
from typing import Any, NamedTuple, TypeVar, cast

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
    (found,) = together([search])
    return cast("Found", found)


def together(
    searches: Sequence[Search[Found]], failed: Callable[[int, Exception], None] | None = None
) -> list[Found | None]:
    """Carry on searches until all have ended.

    Parameters
    ----------
    failed : told of a search that ended in an exception, by its number; None is then what it has found. Without it
        the exception is raised.

    Returns
    -------
    What the searches have found, in their order.
    """
    found: list[Any] = [None] * len(searches)
    asked = dict[int, Ask]()

    def carry_on(number: int, step: Callable[[], Ask]) -> None:
        try:
            asked[number] = step()
        except StopIteration as ended:
            found[number] = ended.value
        except Exception as error:
            if failed is None:
                raise
            failed(number, error)

    for number, search in enumerate(searches):
        carry_on(number, lambda search=search: next(search))
    while asked:
        # The question that most ask is answered first: others may come to ask it too.
        groups: dict[tuple[Any, ...], list[int]] = {}
        for number, ask in asked.items():
            groups.setdefault((ask.method, *ask.settings), []).append(number)
        (method, *settings), numbers = max(groups.items(), key=lambda item: len(item[1]))
        for number, answer in zip(numbers, _answers(method, [asked.pop(n).of for n in numbers], settings), strict=True):
            search = searches[number]
            if isinstance(answer, Exception):
                carry_on(number, lambda search=search, answer=answer: search.throw(answer))
            else:
                carry_on(number, lambda search=search, answer=answer: search.send(answer))
    return found


def _answers(method: Callable[..., list[Any]], of: list[Any], settings: Sequence[Any]) -> list[Any]:
    """Answers to questions; an exception in the place of those that have none."""
    try:
        return method(of, *settings)
    except Exception as error:
        if len(of) == 1:
            return [error]
    # Which of them it is is found by asking one by one.
    return [answer for each in of for answer in _answers(method, [each], settings)]
