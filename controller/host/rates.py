"""The rate of telemetry: what a line carries of it, what a device keeps, and remedies for a slow line."""

from controller.host.driver import Device
from controller.protocol.capacity import Capacity
from controller.protocol.events import News, Samples
from controller.protocol.image import image_bytes
from controller.protocol.messages import Record
from transopt.base.writing import rounded_down

UART_BITS = 10  # bits per byte, start and stop included
FRAMING = 1.08  # bytes on the line over those of the records: headers, check sums, stuffing, events, heartbeats
BAUDS = (
    *(115_200, 230_400, 460_800, 921_600),
    *(1_000_000, 2_000_000, 3_000_000, 4_000_000, 6_000_000, 8_000_000, 12_000_000),
)
MEASURED_S, SETTLED_S = 0.5, 0.1  # a line is measured for so long, and before that flushed of what is under way
MEASUREMENTS = 3  # at most; a pause of the machine makes a line look slower, so that the fastest counts
WHOLE = 0.95  # least share that counts as every record: a batch or an adapter's 16 ms may be missing at either end
NUMBER_BYTES = 4  # a device keeps each record with its number, TD_KEPT_BYTES
LOOK_S = 0.02  # period of records that show no more than the hand: 1.7 kB/s


def carried(device: Device) -> float:
    """Share of the records of every tick that the line carries, 0 to 1; telemetry is off afterwards.

    Raises
    ------
    LinkLostError : the link is lost.
    """
    came: list[int] = []

    def take(news: News) -> None:
        if isinstance(news, Samples):
            came.append(len(news.records))

    device.set_telemetry(1)
    device.listen(SETTLED_S)
    share = 0.0
    with device.heard_by(take):
        for _ in range(MEASUREMENTS):
            came.clear()
            begin_s = device.now_s()
            device.listen(MEASURED_S)
            share = max(share, sum(came) * device.hello.dt_s / (device.now_s() - begin_s))
            if share >= WHOLE:
                break
    device.set_telemetry(0)
    return min(share, 1.0)


def kept_records(capacity: Capacity) -> int:
    """Number of records that fit a library's memory, which a device uses for them while no library is arriving."""
    largest = image_bytes(capacity.speeds, capacity.grips, 0, cool_bits=8) + 2 * capacity.samples
    return largest // (NUMBER_BYTES + Record.FORMAT.size)


def remedy(dt_s: float, carried: float, kept_s: float = 0.0) -> str:
    """A phrase on what to do about a line that carries only a share of the records of every tick.

    Parameters
    ----------
    carried : share of the records carried. kept_s : longest sweep that the device can buffer on this line.
    """
    needed_B_s = Record.FORMAT.size / dt_s
    baud = next((baud for baud in BAUDS if baud >= UART_BITS * FRAMING * needed_B_s), None)
    uart = "" if baud is None else f" or over a UART as PORT@{baud}, its firmware at that rate"
    shorter = (
        f"; a sweep of --seconds {rounded_down(kept_s, 2):g} is kept and sent afterwards" if kept_s > 0.01 else ""
    )
    every = max(round(1 / carried + 0.5), 2) if carried > 0 else 100
    return (
        f"every tick takes {1e-3 * needed_B_s:.0f} kB/s, this line carried {1e-3 * carried * needed_B_s:.0f} kB/s: "
        f"connect it by USB without an adapter{uart}; `transopt-play monitor --every {every}` looks at it as it "
        f"is{shorter}"
    )
