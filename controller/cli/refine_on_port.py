"""Taps for a refinement, from a device on a port: whoever holds it is told where taps are missing."""

from collections.abc import Mapping
from pathlib import Path

from rich.console import Console

from controller.cli.port import StoppedError, load, run
from controller.host.driver import Device
from controller.host.first_run import default_gain
from controller.host.monitor import Monitor
from controller.host.payload import Payload, payload_of
from controller.protocol.codes import LinkNotice
from controller.protocol.image import sha256
from controller.record.recorder import Contact, Recorder, make_room
from controller.refine.rounds import Heard, Node, hear, node_near, nodes_of
from transopt.base.errors import InputError
from transopt.library.library import Library


class EndedError(Exception):
    """A round cannot be finished; the text says why."""


class PortTaps:
    """Puts a library in force and lets the user tap until every node has its taps.

    Parameters
    ----------
    folder : each round is recorded in a folder of its own there. taps : at each node. seconds : after which a round
        ends with what there is; None waits.
    """

    def __init__(
        self,
        device: Device,
        console: Console,
        folder: Path,
        taps: int,
        seconds: float | None,
        accelerometer_Hz: float,
    ) -> None:
        self._device, self._console, self._folder = device, console, folder
        self._taps, self._seconds, self._accelerometer_Hz = taps, seconds, accelerometer_Hz

    def __call__(self, library: Library, number: int) -> Mapping[Node, list[Heard]]:
        """
        Raises
        ------
        InputError : the device has not yet played at full gain, or refuses.
        StoppedError : Ctrl-C.
        EndedError : a fault or a lost lease.
        """
        given, device = payload_of(library), self._device
        if default_gain(device.hello.boot, sha256(given.configuration)) < 1:
            raise InputError(
                f"refine: {device.name} has not played this configuration since its start: play its first taps "
                "quietly with `transopt-play tap LIBRARY --port`, then refine"
            )
        folder = self._folder / f"round_{number}"
        make_room(folder)
        load(device, given)
        contacts = self._tapped(library, given, folder, number)
        heard: dict[Node, list[Heard]] = {node: [] for node in nodes_of(library)}
        for contact in contacts:
            node = node_near(library, contact.speed_m_s, contact.grip_N)
            if node is None:
                continue
            found = hear(contact, library, given.settings, node, self._accelerometer_Hz)
            if isinstance(found, str):
                self._say(f"tap {contact.number} does not count: {found}")
            else:
                heard[node].append(found)
        return heard

    def _say(self, words: str) -> None:
        self._console.print(words, highlight=False, soft_wrap=True)

    def _tapped(self, library: Library, given: Payload, folder: Path, number: int) -> list[Contact]:
        missing = dict.fromkeys(nodes_of(library), self._taps)
        self._say(
            f"round {number}: tap {self._taps} times at each of {len(missing)} nodes: {_nodes(library, missing)}"
        )
        hello, settings, seen = self._device.hello, given.settings, 0
        recorder = Recorder(folder, hello.dt_s, settings.count_m, settings.surface_counts)
        shown = Monitor(self._console, f"round {number} on {self._device.name}", hello.dt_s, settings.count_m)

        def ended() -> bool:
            nonlocal seen
            for contact in recorder.contacts[seen:]:
                seen += 1
                self._count(library, contact, missing)
            return not missing

        stopped = run(self._device, recorder, shown, ended, self._seconds, 1.0)
        if stopped:
            raise StoppedError
        if shown.faults:
            raise EndedError(f"fault: {shown.faults[0].value}")
        if shown.events[LinkNotice.LEASE_LOST]:
            raise EndedError(LinkNotice.LEASE_LOST.value)
        return recorder.contacts

    def _count(self, library: Library, contact: Contact, missing: dict[Node, int]) -> None:
        """Say what a tap counts for and what is left to be tapped."""
        node = node_near(library, contact.speed_m_s, contact.grip_N)
        at = f"tap {contact.number}: {contact.speed_m_s:.3f} m/s, {contact.grip_N:.2f} N"
        if node is None or contact.missed:
            why = f"{contact.missed} records were lost" if contact.missed else "near to no node"
            self._say(f"{at}: {why}, does not count")
            return
        if node in missing:
            missing[node] -= 1
            if missing[node] == 0:
                del missing[node]
        self._say(f"{at}: counts for {_nodes(library, [node])}; missing: {_nodes(library, missing) or 'none'}")


def _nodes(library: Library, nodes: Mapping[Node, int] | list[Node]) -> str:
    """0.1 m/s at 1 N x 2, ..."""
    counts = nodes if isinstance(nodes, Mapping) else {}
    return ", ".join(
        f"{library.speeds_m_s[iv]:g} m/s at {library.grips_N[ig]:g} N"
        + (f" x {counts[iv, ig]}" if (iv, ig) in counts else "")
        for iv, ig in nodes
    )
