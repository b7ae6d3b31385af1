"""Dataclasses whose annotations define their layout in a message: little-endian, without padding."""

import struct
from dataclasses import dataclass, fields
from typing import Annotated, Any, ClassVar, TypeVar, dataclass_transform, get_type_hints

HASH_BYTES = 32
OPEN_END = "*"

U8 = Annotated[int, "B"]
U16 = Annotated[int, "H"]
U32 = Annotated[int, "I"]
I32 = Annotated[int, "i"]
U64 = Annotated[int, "Q"]
F32 = Annotated[float, "f"]
F64 = Annotated[float, "d"]
Hash = Annotated[bytes, f"{HASH_BYTES}s"]
Tail = Annotated[bytes, OPEN_END]


class BadBodyError(ValueError):
    """An intact frame that has no meaning here."""


class Packed:
    """Base of such a dataclass; a last field of type `Tail` takes the remaining bytes.

    Attributes
    ----------
    FORMAT : format of all fields but the tail. OPEN : whether there is a tail.
    """

    __slots__ = ()
    FORMAT: ClassVar[struct.Struct]
    OPEN: ClassVar[bool]
    NAMES: ClassVar[tuple[str, ...]]

    @classmethod
    def layout(cls) -> list[tuple[str, str]]:
        """(field, struct format) in order."""
        hints = get_type_hints(cls, include_extras=True)
        return [(field.name, hints[field.name].__metadata__[0]) for field in fields(cls)]  # type: ignore[arg-type]

    def pack(self) -> bytes:
        values = [getattr(self, name) for name in self.NAMES]
        if self.OPEN:
            tail: bytes = values.pop()
            return self.FORMAT.pack(*values) + tail
        return self.FORMAT.pack(*values)

    @classmethod
    def unpack(cls, body: bytes) -> Any:
        """
        Raises
        ------
        BadBodyError : the length is not that of this message.
        """
        size = cls.FORMAT.size
        if len(body) < size or (len(body) > size and not cls.OPEN):
            raise BadBodyError(f"{cls.__name__}: {len(body)} bytes, expected {size}")
        values = cls.FORMAT.unpack_from(body)
        return cls(*values, *([body[size:]] if cls.OPEN else []))


Message = TypeVar("Message", bound=type[Packed])


@dataclass_transform(frozen_default=True)
def packed(cls: Message) -> Message:
    """Class decorator that makes a frozen dataclass and computes its layout."""
    made: Message = dataclass(frozen=True, slots=True)(cls)  # type: ignore[assignment]
    layout = made.layout()
    formats = [form for _, form in layout]
    made.OPEN = formats[-1:] == [OPEN_END]
    made.FORMAT = struct.Struct("<" + "".join(formats[:-1] if made.OPEN else formats))
    made.NAMES = tuple(name for name, _ in layout)
    return made
