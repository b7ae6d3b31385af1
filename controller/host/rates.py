"""The rate of telemetry, and remedies for a line that is too slow for it."""

from controller.protocol.messages import Record
from transopt.base.writing import rounded_down

UART_BITS = 10  # bits per byte, start and stop included
FRAMING = 1.08  # bytes on the line over those of the records: headers, check sums, stuffing, events, heartbeats
BAUDS = (
    115_200,
    230_400,
    460_800,
    921_600,
    1_000_000,
    2_000_000,
    3_000_000,
    4_000_000,
    6_000_000,
    8_000_000,
    12_000_000,
)


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
