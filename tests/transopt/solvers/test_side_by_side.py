"""Searches that are carried on together: who is asked with whom, and whose exception is whose."""

from collections.abc import Sequence

import pytest

from transopt.solvers.side_by_side import Ask, Search, alone, together


class Halves:
    """A method that halves even numbers, and remembers what it was asked at once."""

    def __init__(self) -> None:
        self.asked: list[list[int]] = []

    def __call__(self, numbers: Sequence[int], *settings: str) -> list[int]:
        self.asked.append(list(numbers))
        if any(number % 2 for number in numbers):
            raise ValueError("an odd number has no half")
        return [number // 2 for number in numbers]


def halvings(method: Halves, number: int, *settings: str) -> Search[int]:
    """How often a number can be halved until it is 1."""
    count = 0
    while number > 1:
        number = yield Ask(method, number, settings)
        count += 1
    return count


def test_those_that_ask_the_same_are_answered_in_one_call() -> None:
    method = Halves()
    assert together([halvings(method, number) for number in (8, 2, 1, 4)]) == [3, 1, 0, 2]
    assert method.asked == [[8, 2, 4], [4, 2], [2]]


def test_another_setting_is_another_question() -> None:
    method = Halves()
    assert together([halvings(method, 2, "a"), halvings(method, 2, "b"), halvings(method, 2, "b")]) == [1, 1, 1]
    assert method.asked == [[2, 2], [2]]


def test_an_exception_is_raised_in_the_search_that_caused_it() -> None:
    method = Halves()

    def told(number: int) -> Search[str]:
        try:
            found = yield from halvings(method, number)
        except ValueError as error:
            return str(error)
        return f"{found} times"

    assert together([told(4), told(6), told(8)]) == ["2 times", "an odd number has no half", "3 times"]
    with pytest.raises(ValueError, match="an odd number"):
        together([halvings(method, 4), halvings(method, 3)])


def test_alone_a_search_reads_as_it_runs() -> None:
    method = Halves()
    assert alone(halvings(method, 16)) == 4
    assert method.asked == [[16], [8], [4], [2]]
    assert together([]) == []
