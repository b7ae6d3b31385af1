"""The host of `unplug_processes`: a process of its own, to be killed; says on standard output where it is and when.

python scripts/unplug_host.py PORT FOLDER LEASE_MS
"""

import sys
import time
from contextlib import suppress
from pathlib import Path

from compiled_device import DT_S, SETTINGS
from unplug_cases import CONFIGURATION, IMAGE

from controller.driver import Device, DeviceError, LinkLostError
from controller.recorder import Recorder
from controller.told import Ended, Told

EVERY, PENDING_S, ARMING_S, LISTENED_S = 2, 0.1, 5.0, 60.0


def say(word: str) -> None:
    """The clock is that of all processes of this machine."""
    print(word, time.monotonic(), flush=True)


def ended(news: Told) -> None:
    if isinstance(news, Ended):
        say("ended")


def arm(device: Device, lease_ms: int) -> None:
    """As soon as the hand is at rest."""
    end_s = time.monotonic() + ARMING_S
    while True:
        try:
            device.arm(1.0, lease_ms)
            return
        except LinkLostError:
            raise
        except DeviceError:
            if time.monotonic() > end_s:
                raise
            device.listen(0.02)


def main() -> int:
    port, folder, lease_ms = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3])
    with suppress(LinkLostError), Recorder(folder, DT_S, SETTINGS.count_m) as recorder:
        say("connect")
        with Device(port) as device:
            device.listeners += [recorder.take, ended]
            say("configure")
            device.configure(CONFIGURATION)
            device.set_telemetry(EVERY)
            say("upload")
            device.upload(IMAGE)
            say("pending")
            device.listen(PENDING_S)
            device.checked()
            arm(device, lease_ms)
            say("armed")
            device.listen(LISTENED_S)
    return 0


if __name__ == "__main__":
    sys.exit(main())
