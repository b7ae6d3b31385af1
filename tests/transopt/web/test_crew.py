"""The processes that solve a page's taps side by side: the same answers, whoever dies or gives up meanwhile."""

import os
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

import numpy as np
import pytest

from transopt.scene.builtin import load_scene
from transopt.scene.keys import with_values
from transopt.web.crew import Crew, service_name
from transopt.web.service import Service
from transopt.web.shown import Shown

pytestmark = pytest.mark.timeout(300)
WAIT_S = 60.0


@pytest.fixture(scope="module")
def service() -> Service:
    small = {"grid.speeds_m_s": [0.2, 0.4], "grid.grips_N": [2.0, 3.0], "time.stages": 320}
    return Service(with_values(load_scene("wood_on_foam"), small))


@contextmanager
def enlisted() -> Iterator[Crew]:
    found = Crew(2)
    found.enlist()
    yield found
    found.end()


@pytest.fixture(scope="module")
def crew() -> Iterator[Crew]:
    with enlisted() as found:
        yield found


@pytest.fixture
def own_crew() -> Iterator[Crew]:
    """One that a test may kill or end."""
    with enlisted() as found:
        yield found


def alone(service: Service, order: list[int]) -> list[Shown]:
    return Crew(0).quick("alone", service, order)


def same(found: list[Shown], expected: list[Shown]) -> None:
    assert [shown.index for shown in found] == [shown.index for shown in expected]
    for one, other in zip(found, expected, strict=True):
        assert (one.certified, one.reason, one.binds) == (other.certified, other.reason, other.binds)
        # Searches begin where limits bound before in the same process, so that answers differ within their tolerance.
        assert one.heat_A2_ms == pytest.approx(other.heat_A2_ms, rel=1e-7)
        assert one.curves is not None
        assert other.curves is not None
        np.testing.assert_allclose(one.curves.input, other.curves.input, atol=1e-6)
        np.testing.assert_allclose(one.curves.clipped_m_s2, other.curves.clipped_m_s2, atol=1e-6)


def test_the_answers_are_those_of_one_process(crew: Crew, service: Service) -> None:
    name = service_name()
    assert len(crew.numbers) == 2
    for limit_A in (4.0, 2.5, 3.0):
        service.change({"limits.current_A": limit_A})
        for order in (service.order(3), service.order(0), [2]):
            same(crew.quick(name, service, order), alone(service, order))


def test_a_tap_between_the_nodes_and_another_time_axis_are_taken_along(crew: Crew, service: Service) -> None:
    name = service_name()
    same(crew.quick(name, service, service.order(0)), alone(service, service.order(0)))
    service.change({"limits.current_A": 3.5}, (0.31, 2.4))
    same(crew.quick(name, service, service.order(4)), alone(service, service.order(4)))
    shorter = Service(with_values(service.opened, {"time.stages": 150}))
    same(crew.quick(service_name(), shorter, shorter.order(1)), alone(shorter, shorter.order(1)))
    service.change({}, None)


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal here")
def test_the_share_of_one_that_was_killed_is_solved_and_another_takes_its_place(
    own_crew: Crew, service: Service
) -> None:
    crew = own_crew
    name, before = service_name(), crew.numbers
    expected = alone(service, service.order(1))
    same(crew.quick(name, service, service.order(1)), expected)
    for number in before:
        os.kill(number, signal.SIGKILL)
    same(crew.quick(name, service, service.order(1)), expected)
    crew.enlist()
    assert len(crew.numbers) == 2
    assert not set(crew.numbers) & set(before)
    same(crew.quick(name, service, service.order(1)), expected)


def test_while_it_works_for_one_window_another_is_served_by_the_server(crew: Crew, service: Service) -> None:
    expected = alone(service, service.order(2))
    began, ends = threading.Event(), threading.Event()

    class Held(Service):
        """One whose server's share takes until it may end; the crew's own copy of it does not wait."""

        def quick(self, indices: Sequence[int]) -> list[Shown]:
            began.set()
            assert ends.wait(WAIT_S)
            return super().quick(indices)

        def __reduce__(self) -> tuple[object, ...]:
            return object.__new__, (Service,), self.__getstate__()

    held = object.__new__(Held)
    vars(held).update(vars(service.another()))
    found: list[Shown] = []
    first = threading.Thread(target=lambda: found.extend(crew.quick(service_name(), held, held.order(0))))
    first.start()
    try:
        assert began.wait(WAIT_S)
        same(crew.quick(service_name(), service, service.order(2)), expected)
        assert not found
    finally:
        ends.set()
        first.join(WAIT_S)
    assert [shown.index for shown in found] == service.order(0)


@pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="waits for the end of processes that are not its own")
def test_none_is_left_when_its_program_ends(own_crew: Crew) -> None:
    numbers = own_crew.numbers
    own_crew.end()
    program = (
        "import os\nfrom transopt.web.crew import Crew\ncrew = Crew(2)\ncrew.enlist()\n"
        "print(*crew.numbers, flush=True)\nos._exit(0)\n"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=200, check=True)
    left = [int(number) for number in run.stdout.split()]
    assert len(left) == 2
    for number in numbers:
        with pytest.raises(ProcessLookupError):
            os.kill(number, 0)
    # A program that does not tidy up leaves processes that find their input closed, and end by themselves.
    for number in left:
        with suppress(ProcessLookupError), os.fdopen(os.pidfd_open(number)) as process:
            assert select.select([process], [], [], 60.0)[0]
