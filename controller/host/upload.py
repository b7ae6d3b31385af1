"""The sending half of a windowed upload: go-back-N with cumulative acknowledgements, sans-IO.

The device accepts DATA only in order and answers each frame with the offset that it wants next. A repeated answer
means a loss: everything from that offset on is sent again, once per loss. Without any answer a timer does the same;
its timeout doubles up to a bound.
"""

from controller.protocol.messages import Data

FIRST_PATIENCE_S, LEAST_PATIENCE_S, MOST_PATIENCE_S = 0.1, 0.02, 0.25
STALLED_S = 5.0


class Patience:
    """Retransmission timeout: from measured round trips (Jacobson 1988), doubled after every expiry."""

    def __init__(self) -> None:
        self._smooth_s: float | None = None
        self._spread_s = 0.0
        self._factor = 1.0

    def seen(self, trip_s: float) -> None:
        """Take a round trip; only of a frame that was sent once (Karn's rule)."""
        if self._smooth_s is None:
            self._smooth_s, self._spread_s = trip_s, trip_s / 2
        else:
            self._spread_s += (abs(trip_s - self._smooth_s) - self._spread_s) / 4
            self._smooth_s += (trip_s - self._smooth_s) / 8
        self._factor = 1.0

    def in_vain(self) -> None:
        self._factor *= 2.0

    def progressed(self) -> None:
        self._factor = 1.0

    def now_s(self) -> float:
        base = FIRST_PATIENCE_S if self._smooth_s is None else self._smooth_s + 4 * self._spread_s
        return min(max(base, LEAST_PATIENCE_S) * self._factor, MOST_PATIENCE_S)


class BadAckError(ValueError):
    """The device acknowledges bytes that were never sent."""


class Upload:
    """The upload of one image with a window of `window_frames` frames of `chunk` bytes.

    Attributes
    ----------
    acknowledged : number of bytes that have arrived.
    """

    def __init__(self, image: bytes, offset: int, window_frames: int, chunk: int, patience: Patience) -> None:
        self._image, self._chunk, self._patience = image, chunk, patience
        self._window = max(window_frames, 1) * chunk
        self.acknowledged = self._next = self._highest = offset
        self._repeats = self._tolerated = 0  # repeated answers since the last loss that was acted on
        self._timed: tuple[int, float] | None = None  # end of a frame sent only once, and when
        self._deadline_s: float | None = None
        self._progress_s: float | None = None  # when the last thing arrived

    @property
    def complete(self) -> bool:
        return self.acknowledged == len(self._image)

    @property
    def deadline_s(self) -> float | None:
        """Time of the retransmission if no answer comes; None if nothing is unacknowledged."""
        return self._deadline_s

    def stalled(self, now_s: float) -> bool:
        """Whether the upload has made no progress for too long, though the device is alive."""
        return self._progress_s is not None and now_s - self._progress_s >= STALLED_S

    def acknowledge(self, wanted: int, now_s: float) -> bool:
        """Take an ACK; return whether it was progress.

        Raises
        ------
        BadAckError : the ACK lies beyond what was sent.
        """
        if wanted > self._highest:
            raise BadAckError(f"device wants offset {wanted}, {self._highest} of {len(self._image)} sent")
        if wanted > self.acknowledged:
            if self._timed is not None and wanted >= self._timed[0]:
                self._patience.seen(now_s - self._timed[1])
                self._timed = None
            self._patience.progressed()
            self._progress_s = now_s
            self.acknowledged = wanted
            self._next = max(self._next, wanted)
            self._repeats = self._tolerated = 0
            self._deadline_s = None if self._next == wanted else now_s + self._patience.now_s()
            return True
        if wanted == self.acknowledged and self._next > wanted:
            # Each frame in flight behind the loss repeats the answer once; only further repeats mean another loss.
            self._repeats += 1
            if self._repeats > self._tolerated:
                self._go_back()
        return False

    def frames(self, now_s: float) -> list[Data]:
        """The frames that may be sent now."""
        if self._deadline_s is not None and now_s >= self._deadline_s:
            self._patience.in_vain()
            self._go_back()
            self._deadline_s = None
        if self._progress_s is None:
            self._progress_s = now_s
        out = []
        end = min(self.acknowledged + self._window, len(self._image))
        while self._next < end:
            part = self._image[self._next : self._next + self._chunk]
            out.append(Data(self._next, part))
            self._next += len(part)
            if self._next > self._highest:
                self._highest = self._next
                self._timed = self._timed or (self._next, now_s)
        if out and self._deadline_s is None:
            self._deadline_s = now_s + self._patience.now_s()
        return out

    def _go_back(self) -> None:
        self._tolerated = -(-(self._next - self.acknowledged) // self._chunk)
        self._repeats = 0
        self._next, self._timed = self.acknowledged, None
