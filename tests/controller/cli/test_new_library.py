"""A library that is new to a checked device is tapped once at a tenth before it is played."""

from dataclasses import replace

import pytest
from rich.console import Console

from controller.cli.port import _try_out
from controller.device.device_file import Accelerometer, DeviceFile
from controller.host.driver import Device, DeviceError
from controller.host.payload import payload_of
from controller.protocol.image import bank_of, image_of
from controller.servo.interface import Output, State
from controller.sim.port import SimulatedPort
from tests.benches.own_device import OwnWorld
from tests.benches.probed import ProbedDevice
from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.library.library import Library

LEVEL = DeviceFile(name="trial", accelerometer=Accelerometer(rest_m_s2=STANDARD_GRAVITY_M_S2))


class Tapped(OwnWorld):
    """A person who taps once the device is armed."""

    tapped = False

    def advance(self, output: Output) -> None:
        if output.state is State.ARMED and not self.tapped:
            self.tapped = True
            self.person.tap(0.3)
        super().advance(output)


class Port(SimulatedPort):
    """One of a device that can do harm."""

    name, harmless = "own device", False


def test_a_new_library_is_tapped_once_at_a_tenth(library: Library, c_compiler: None) -> None:
    given, world = payload_of(library, device=LEVEL), Tapped()
    settings = given.settings
    table, head = bank_of(given.image)
    weaker = replace(table, command_A=0.9 * table.command_A)
    other = image_of(weaker, settings.dt_s, settings.lead_s, head["tail_samples"], amplifier=settings.amplifier)
    with Device(Port(ProbedDevice(1, simulated=False), world, settings.dt_s)) as device:
        device.configure(given.configuration)
        device.upload(given.image)
        assert not device.lacks_trial()  # without sound pulses a trial is not what is missing
        device.pulse(settings.pulse_A, settings.pulse_ticks, 2)
        device.listen(2.5)
        assert device.lacks_trial()
        with pytest.raises(DeviceError, match="no finished trial of this library"):
            device.arm(1.0)
        _try_out(device, Console(quiet=True), 3.0)
        assert world.tapped
        assert not device.lacks_trial()
        device.upload(other)
        assert device.lacks_trial()
