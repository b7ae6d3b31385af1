"""Taps for a refinement: whoever holds the device learns where taps are missing."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol, Self

from rich.console import Console

from controller.cli.bench import Bench, simulated_bench
from controller.cli.port import StoppedError, load, run
from controller.device.device_file import DeviceFile
from controller.host.driver import Device
from controller.host.payload import Payload, payload_of
from controller.protocol.codes import LinkNotice
from controller.record.recorder import Contact, Recorder, make_room
from controller.refine.heard import Heard, Node, hear, node_near
from controller.refine.learner import LEAST_TAPS
from controller.refine.tables import place
from controller.servo.settings import Settings
from controller.sim.sensors import noise_seed
from controller.sim.simulated_tap import SimulatedTap
from controller.sim.simulator import Imperfections
from controller.sim.tapping import TappingHand, tap_of
from controller.sim.true_device import TrueDevice
from transopt.base import terminal
from transopt.library.library import Library


class EndedError(Exception):
    """A round cannot be finished; the text says why."""


class Hand(Protocol):
    """Whoever holds the device; a context manager for the length of the refinement.

    Attributes
    ----------
    amplifier_tolerance : by which the true amplifier may differ from the library's, see `Settings`.
    """

    @property
    def amplifier_tolerance(self) -> float: ...

    def asked(self, library: Library, number: int, nodes: Sequence[Node], taps: int) -> None:
        """For so many taps at each of some nodes of a library, in a round."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...


class PersonsHand:
    """Hand of a person who reads the console."""

    amplifier_tolerance = 0.0

    def __init__(self, console: Console) -> None:
        self._console = console

    def asked(self, library: Library, number: int, nodes: Sequence[Node], taps: int) -> None:
        missing = dict.fromkeys(nodes, taps)
        words = f"round {number}: tap {taps} times at each of {len(missing)} nodes: {_nodes(library, missing)}"
        self._console.print(words)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass


class SimulatedHand:
    """Taps as it is asked, by the hand of the recordings, with another phase and noise in every tap."""

    def __init__(self, device: TrueDevice, imperfections: Imperfections, seed: int) -> None:
        self._device, self._imperfections, self._seed = device, replace(imperfections, mismatch=0.0), seed
        self.amplifier_tolerance = imperfections.mismatch
        self._progress = terminal.progress()
        self._bar, self._in_all = self._progress.add_task("taps", total=None), 0
        self.hand: TappingHand | None = None

    def tapped(self) -> None:
        self._progress.advance(self._bar)

    def asked(self, library: Library, number: int, nodes: Sequence[Node], taps: int) -> None:
        assert self.hand is not None
        self._in_all += taps * len(nodes)
        self._progress.update(self._bar, total=self._in_all)
        each = [(node, n) for node in nodes for n in range(taps)]
        self.hand.plan(tap_of(library, self._device, self.tap(library, number, *one)) for one in each)

    def tap(self, library: Library, number: int, node: Node, n: int) -> SimulatedTap:
        """One of the taps that are asked for."""
        return SimulatedTap(
            speed_m_s=float(library.speeds_m_s[node[0]]),
            grip_N=float(library.grips_N[node[1]]),
            seed=noise_seed(self._seed, number, *node, n),
            imperfections=self._imperfections,
        )

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()


def simulated_at(
    library: Library,
    device: TrueDevice,
    imperfections: Imperfections,
    seed: int,
    described: DeviceFile,
) -> tuple[Bench, Hand]:
    """The bench of a true device, mismatch included, and the hand on it.

    Parameters
    ----------
    described : how its sensors and its amplifier are wired.

    Raises
    ------
    InputError : there is no C compiler.
    """
    simulated = SimulatedHand(device, imperfections, seed)
    given = payload_of(library, device=described, amplifier_tolerance=imperfections.mismatch)
    bench, simulated.hand = simulated_bench(given, device, (), described=described, tapped=simulated.tapped)
    return bench, simulated


class Taps:
    """Puts a library in force and lets the user tap until every node has its taps.

    Parameters
    ----------
    described : what the device is.
    folder : each round on a device that cannot be had again is recorded in a folder of its own there.
    taps : at each node.
    seconds : after which a round ends with what there is; None waits.
    """

    def __init__(
        self,
        device: Device,
        bench: Bench,
        hand: Hand,
        described: DeviceFile,
        folder: Path,
        taps: int,
        seconds: float | None,
    ) -> None:
        self._device, self._bench, self._hand, self._folder = device, bench, hand, folder
        self._described, self._taps, self._seconds = described, taps, seconds

    def __call__(self, library: Library, number: int, nodes: Sequence[Node]) -> Mapping[Node, list[Heard]]:
        """
        Raises
        ------
        InputError : the device refuses, as one that has not passed its check does.
        StoppedError : Ctrl-C.
        EndedError : a fault, a lost lease, or too few taps that count.
        """
        contacts, settings = self.contacts(library, number, nodes)
        heard: dict[Node, list[Heard]] = {node: [] for node in nodes}
        silent: list[str] = []
        for contact in contacts:
            node = node_near(library, contact.speed_m_s, contact.grip_N)
            if node is None or node not in heard:
                continue
            found = hear(contact, library, settings, node, self._described.accelerometer)
            if isinstance(found, str):
                silent.append(f"tap {contact.number} does not count: {found}")
            else:
                heard[node].append(found)
        if self._bench.console.quiet:
            # Nobody acts on single taps of a simulated hand: one tells why the others do not count either.
            silent = [f"{silent[0]} ({len(silent)} of {len(contacts)} taps do not count)"] if silent else []
        for words in silent:
            terminal.console().print(words, style="yellow")
        if silent and max(map(len, heard.values())) < LEAST_TAPS:
            raise EndedError(f"round {number}: no node has {LEAST_TAPS} taps that count")
        return heard

    def contacts(self, library: Library, number: int, nodes: Sequence[Node]) -> tuple[Sequence[Contact], Settings]:
        """All taps of a round as the device recorded them, and the settings that it had; errors as of a call."""
        given = payload_of(library, device=self._described, amplifier_tolerance=self._hand.amplifier_tolerance)
        device = self._device
        folder = None if device.harmless else self._folder / f"round_{number}"
        if folder is not None:
            make_room(folder)
        load(device, given, self._bench.console)
        return self._tapped(library, given, folder, number, nodes), given.settings

    def _say(self, words: str) -> None:
        self._bench.console.print(words)

    def _tapped(
        self, library: Library, given: Payload, folder: Path | None, number: int, nodes: Sequence[Node]
    ) -> list[Contact]:
        missing, seen = dict.fromkeys(nodes, self._taps), 0
        self._hand.asked(library, number, nodes, self._taps)
        hello, settings = self._device.hello, given.settings
        recorder = Recorder(folder, hello.dt_s, settings.count_m, settings.surface_counts)

        def enough() -> bool:
            nonlocal seen
            for contact in recorder.contacts[seen:]:
                seen += 1
                self._count(library, contact, nodes, missing)
            return not missing

        title = f"round {number} on {self._device.name}"
        shown, stopped = run(
            self._bench, self._device, recorder, title, enough=enough, seconds=self._seconds, gain=1.0
        )
        if stopped:
            raise StoppedError
        if shown.faults:
            raise EndedError(f"fault: {shown.faults[0].value}")
        if shown.events[LinkNotice.LEASE_LOST]:
            raise EndedError(LinkNotice.LEASE_LOST.value)
        return recorder.contacts

    def _count(self, library: Library, contact: Contact, nodes: Sequence[Node], missing: dict[Node, int]) -> None:
        """Say what a tap counts for and what is left to be tapped."""
        node = node_near(library, contact.speed_m_s, contact.grip_N)
        at = f"tap {contact.number}: {contact.speed_m_s:.3f} m/s, {contact.grip_N:.2f} N"
        if node not in nodes or contact.spoilt:
            why = "near to no node" if node is None else f"{place(library, node)} is not asked for in this round"
            self._say(f"{at}: {contact.spoilt or why}, does not count")
            return
        assert node is not None
        if node in missing:
            missing[node] -= 1
            if missing[node] == 0:
                del missing[node]
        self._say(f"{at}: counts for {_nodes(library, [node])}; missing: {_nodes(library, missing) or 'none'}")


def _nodes(library: Library, nodes: Mapping[Node, int] | list[Node]) -> str:
    """0.1 m/s at 1 N x 2, ..."""
    counts = nodes if isinstance(nodes, Mapping) else {}
    return ", ".join(place(library, node) + (f" x {counts[node]}" if node in counts else "") for node in nodes)
