"""What a device keeps: the configuration and the library in force, and the ones that are arriving."""

import hashlib
import math

from controller.protocol.capacity import Capacity, Hardware
from controller.protocol.codes import Reason
from controller.protocol.configuration import CONFIGURATION_BYTES, EMPTY, Configuration, ConfigurationError, accept
from controller.protocol.image import ImageError, capacity_bytes, check
from controller.protocol.messages import NO_HASH
from controller.waveforms.bank import Bank


class RefusedError(Exception):
    """A request is not carried out; `value` is the number that offends, NaN if there is none."""

    def __init__(self, reason: Reason, value: float = math.nan) -> None:
        super().__init__(reason.value)
        self.reason, self.value = reason, value


class Store:
    """Nothing is in force before it has arrived whole and been checked, and until then what was stays in force.

    Attributes
    ----------
    configuration : None before the first. library_sha256 : zero without a library.
    arrived : bytes of the image on its way.
    """

    def __init__(self, capacity: Capacity, hardware: Hardware) -> None:
        self._capacity, self._hardware = capacity, hardware
        self.configuration: Configuration | None = None
        self.library_sha256 = NO_HASH
        self._image = b""
        self._draft = bytearray(CONFIGURATION_BYTES)
        self._forget()

    def _forget(self) -> None:
        self._staged, self._length, self._sha256 = bytearray(), 0, NO_HASH

    @property
    def configuration_sha256(self) -> bytes:
        return NO_HASH if self.configuration is None else self.configuration.sha256

    @property
    def arrived(self) -> int:
        return len(self._staged)

    def configure(self, offset: int, data: bytes) -> None:
        """A part of the coming configuration."""
        end = offset + len(data)
        if not data or end > len(self._draft):
            raise RefusedError(Reason.BAD_OFFSET, offset)
        self._draft[offset:end] = data

    def configure_commit(self, sha256: bytes) -> tuple[Configuration, Bank]:
        """Put the configuration in force, and the library out of force if it does not fit it."""
        draft = bytes(self._draft)
        if hashlib.sha256(draft).digest() != sha256:
            raise RefusedError(Reason.WRONG_HASH)
        try:
            configuration = accept(draft, self._capacity, self._hardware)
        except ConfigurationError as error:
            raise RefusedError(error.reason, error.value) from None
        self.configuration = configuration
        try:
            return configuration, check(self._image, configuration, self._capacity) if self._image else EMPTY
        except ImageError:
            self._image, self.library_sha256 = b"", NO_HASH
            return configuration, EMPTY

    def begin(self, length: int, sha256: bytes) -> int:
        """An image is coming; the offset to go on from, where it was interrupted if it is the same one."""
        if length > capacity_bytes(self._capacity):
            raise RefusedError(Reason.TOO_LARGE, length)
        if (length, sha256) != (self._length, self._sha256):
            # What is in force need not come again.
            there = self._image if (length, sha256) == (len(self._image), self.library_sha256) else b""
            self._staged, self._length, self._sha256 = bytearray(there), length, sha256
        return self.arrived

    def take(self, offset: int, data: bytes) -> None:
        """A part of the image, if it is the next one."""
        if offset == self.arrived and offset + len(data) <= self._length:
            self._staged += data

    def commit(self) -> Bank:
        """Check the image whole and put it in force."""
        if self.configuration is None:
            raise RefusedError(Reason.NO_CONFIGURATION)
        if not self._length or self.arrived != self._length:
            raise RefusedError(Reason.INCOMPLETE, self.arrived)
        image, sha256 = bytes(self._staged), self._sha256
        # Used up in any case: what failed once is not what the next upload resumes.
        self._forget()
        if hashlib.sha256(image).digest() != sha256:
            raise RefusedError(Reason.WRONG_HASH)
        try:
            bank = check(image, self.configuration, self._capacity)
        except ImageError as error:
            raise RefusedError(error.reason, error.value) from None
        self._image, self.library_sha256 = image, sha256
        return bank
