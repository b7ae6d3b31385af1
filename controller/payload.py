"""What a device is given to play a library: configuration and image, with what they were made of."""

from dataclasses import dataclass
from pathlib import Path

from controller.bank import Method, bank
from controller.configuration import configuration_of
from controller.image import image_of
from controller.settings import Settings
from transopt.library import Library
from transopt.library_file import load_library


@dataclass(frozen=True)
class Payload:
    """One library as a device takes it: bytes of `configuration_of` and of `image_of`."""

    library: Library
    settings: Settings
    configuration: bytes
    image: bytes


def payload(path: Path) -> Payload:
    """
    Raises
    ------
    InputError : no library, or one that no device could play.
    """
    return payload_of(load_library(path))


def payload_of(library: Library) -> Payload:
    """
    Raises
    ------
    InputError : one that no device could play.
    """
    settings = Settings.of(library)
    tail = library.meta["hand_over_samples"]
    image = image_of(bank(library, Method.BILINEAR), settings.dt_s, settings.lead_s, tail)
    return Payload(library, settings, configuration_of(settings), image)
