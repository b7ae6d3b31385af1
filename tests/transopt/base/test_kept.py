"""A cache of the most recent values: what it keeps, what it drops, and who may share it."""

import threading

from transopt.base.kept import Kept


def test_the_most_recent_values_are_kept() -> None:
    kept, made = Kept[str](2), list[str]()

    def get(key: str) -> str:
        return kept.get(key, lambda: made.append(key) or key.upper())

    assert [get(key) for key in "abab"] == ["A", "B", "A", "B"]
    assert made == ["a", "b"]
    assert get("a") == "A"
    assert get("c") == "C"  # drops b, which was read before a
    assert get("a") == "A"
    assert made == ["a", "b", "c"]
    get("b")
    assert made == ["a", "b", "c", "b"]


def test_several_threads_share_one() -> None:
    kept, wrong = Kept[int](3), list[tuple[int, int]]()

    def read(first: int) -> None:
        for number in range(first, first + 3000):
            key = number % 7
            if (found := kept.get(key, lambda key=key: key + 100)) != key + 100:
                wrong.append((key, found))

    threads = [threading.Thread(target=read, args=(first,)) for first in range(4)]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    assert not wrong
