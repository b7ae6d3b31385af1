"""Taps for a refinement, from the simulator."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from controller.record.metrics import align
from controller.record.recorder import Contact
from controller.refine.rounds import Heard, Node, hear, nodes_of
from controller.servo.interface import Notice
from controller.servo.settings import Settings
from controller.sim.records import noise_seed, played_record
from controller.sim.simulator import Imperfections
from controller.sim.true_device import Device
from transopt.library.library import Library


class SimulatedTaps:
    """Plays every node of a library some times on a true device, by the mild user.

    Parameters
    ----------
    device : the true one. seed : of phases and noise, which are others in every tap.
    done : called after each tap.
    """

    def __init__(
        self,
        device: Device,
        taps: int,
        *,
        imperfections: Imperfections,
        seed: int,
        done: Callable[[], None] = lambda: None,
    ) -> None:
        self._device, self._taps, self._done = device, taps, done
        self._imperfections, self._seed = imperfections, seed

    def __call__(self, library: Library, number: int) -> Mapping[Node, list[Heard]]:
        settings = Settings.of(library, amplifier_tolerance=self._imperfections.mismatch)
        heard: dict[Node, list[Heard]] = {node: [] for node in nodes_of(library)}
        for node, taps in heard.items():
            for n in range(self._taps):
                found = self._tap(library, settings, node, noise_seed(self._seed, number, *node, n))
                if found is not None:
                    taps.append(found)
                self._done()
        return heard

    def _tap(self, library: Library, settings: Settings, node: Node, seed: int) -> Heard | None:
        """One tap through the device's own sensors; None if nothing was played or heard."""
        speed, grip = float(library.speeds_m_s[node[0]]), float(library.grips_N[node[1]])
        sensors = self._imperfections.sensors
        played, record = played_record(
            library, self._device, settings, speed, grip, imperfections=self._imperfections, seed=seed
        )
        begun = [event for event in played.events if event.what is Notice.CONTACT]
        if not begun:
            return None
        columns = record.columns
        contact = Contact(
            number=1,
            tick=begun[0].tick,
            speed_m_s=begun[0].speed_m_s,
            grip_N=begun[0].grip_N,
            dt_s=settings.dt_s,
            ticks=np.arange(columns["time_s"].size, dtype=float),
            counts=columns["position_m"] / sensors.count_m,
            acceleration_m_s2=columns["acceleration_m_s2"],
            current_A=columns["current_A"],
            missed=0,
        )
        found = hear(contact, library, settings, node, sensors.accelerometer_bandwidth_Hz)
        if isinstance(found, str):
            return None
        times, reference = library.time_grid().switching_times_s, library.reference_m_s2[node[0]]
        true = align(played.times_s, played.acceleration_m_s2, times, reference).nrmse
        return replace(found, peak_current_A=played.metrics.peak_current_A, true_nrmse=true)
