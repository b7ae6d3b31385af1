"""The host of `unplug_processes`: a process of its own, to be killed; says on standard output where it is and when.

It is started as `python -m tests.campaigns.unplug_host PORT FOLDER LEASE_MS` in the checkout.
"""

import sys
import time
from contextlib import suppress
from pathlib import Path

from controller.host.driver import Device, LinkLostError, arm_at_rest
from controller.protocol.events import Ended, News
from controller.record.recorder import Recorder
from tests.benches.compiled import DT_S, SETTINGS
from tests.campaigns.unplug_cases import CONFIGURATION, IMAGE

EVERY, PENDING_S, ARMING_S, LISTENED_S = 2, 0.1, 5.0, 60.0


def say(word: str) -> None:
    """The clock is that of all processes of this machine."""
    print(word, time.monotonic(), flush=True)


def ended(news: News) -> None:
    if isinstance(news, Ended):
        say("ended")


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
            arm_at_rest(device, lease_ms, ARMING_S)
            say("armed")
            device.listen(LISTENED_S)
    return 0


if __name__ == "__main__":
    sys.exit(main())
