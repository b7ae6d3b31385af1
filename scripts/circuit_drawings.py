"""Schematics of the two built-in circuits, with the values that `transopt-play device circuit` finds for them.

    python scripts/circuit_drawings.py --out docs/howto

Writes circuit_servo.svg and circuit_bridge.svg. Positions are in pixels, by hand; values come from the circuit files.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

from common.command import run
from typer import Option

from controller.device.circuit_file import CIRCUITS, Electronics, load_circuit

HEAD = """\
<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img" aria-label="{title}">
<style>path{{fill:none;stroke:#222;stroke-width:1.5}}.b{{fill:#fff}}text{{font:13px sans-serif;fill:#222}}
.s{{font-size:11px;fill:#555}}.m{{text-anchor:middle}}</style><rect width="{width}" height="{height}" fill="#fff"/>
"""


class Drawing:
    """Marks of one schematic, written one after the other."""

    def __init__(self, title: str, width: int, height: int) -> None:
        self.lines = [HEAD.format(title=title, width=width, height=height)]

    def wire(self, *points: tuple[float, float]) -> None:
        self._path("M" + " L".join(f"{x:g} {y:g}" for x, y in points))

    def _path(self, d: str, kind: str = "") -> None:
        self.lines.append(f'<path d="{d}"{kind}/>\n')

    def text(self, x: float, y: float, words: str, kind: str = "") -> None:
        self.lines.append(
            f'<text x="{x:g}" y="{y:g}"{f" class={chr(34)}{kind}{chr(34)}" if kind else ""}>{words}</text>\n'
        )

    def dots(self, *points: tuple[float, float]) -> None:
        for x, y in points:
            self.lines.append(f'<circle cx="{x:g}" cy="{y:g}" r="3"/>\n')

    def across(self, x: float, y: float, name: str) -> None:
        """A resistor from x to x + 60, its name above it."""
        self.wire((x, y), (x + 10, y))
        self._path(f"M{x + 10:g} {y - 7:g} h40 v14 h-40 z", ' class="b"')
        self.wire((x + 50, y), (x + 60, y))
        self.text(x + 30, y - 12, name, "m")

    def down(self, x: float, y: float, name: str, *, ends: str = "", capacitor: bool = False) -> None:
        """A resistor or a capacitor from y to y + 60, its name beside it; `ends` at ground or says where."""
        if capacitor:
            self._path(f"M{x:g} {y:g} v26 m-11 0 h22 m-22 8 h22 m-11 0 v26")
        else:
            self.wire((x, y), (x, y + 10))
            self._path(f"M{x - 7:g} {y + 10:g} h14 v40 h-14 z", ' class="b"')
            self.wire((x, y + 50), (x, y + 60))
        self.text(x + 13, y + 35, name)
        if ends == "ground":
            self.ground(x, y + 60)
        elif ends:
            self.text(x, y + 74, ends, "m")

    def ground(self, x: float, y: float) -> None:
        self._path(f"M{x - 10:g} {y:g} h20 M{x - 6:g} {y + 4:g} h12 M{x - 2:g} {y + 8:g} h4")

    def amplifier(self, x: float, y: float, name: str) -> None:
        """A triangle: input minus at (x, y - 15), plus at (x, y + 15), output at (x + 60, y)."""
        self._path(f"M{x:g} {y - 32:g} v64 l60 -32 z", ' class="b"')
        self.text(x + 5, y - 10, "−")
        self.text(x + 5, y + 20, "+")
        self.text(x + 17, y + 4, name)

    def box(self, x: float, y: float, width: float, height: float, *words: str) -> None:
        self._path(f"M{x:g} {y:g} h{width:g} v{height:g} h{-width:g} z", ' class="b"')
        for j, line in enumerate(words):
            self.text(x + width / 2, y + 20 + 16 * j, line, "m" if j == 0 else "m s")

    def done(self) -> str:
        return "".join(self.lines) + "</svg>\n"


def value(ohm: float) -> str:
    return f"{ohm / 1e3:.4g}k" if ohm < 1e6 else f"{ohm / 1e6:.4g}M"


def named(parts: Iterable[tuple[str, float]]) -> dict[str, str]:
    return {name: f"{name} {value(ohm)}" for name, ohm in parts}


def enable(d: Drawing, y: float) -> None:
    """From the pins to the amplifier's enable: monostable, emergency stop, pull-down."""
    d.box(20, y, 110, 56, "processor", "alive (pin 8)", "enable (pin 6)")
    d.wire((130, y + 15), (210, y + 15))
    d.box(210, y - 5, 150, 40, "74HC123", "retriggered, 1 ms")
    d.wire((360, y + 15), (420, y + 15))
    d.wire((130, y + 45), (420, y + 45))
    d.dots((180, y + 45))
    d.down(180, y + 45, "10k", ends="ground")
    d.box(420, y, 90, 56, "74HC08", "and")
    d.wire((510, y + 28), (570, y + 28), (606, y + 20))  # the lever rests on its contact
    d.wire((600, y + 15), (600, y + 28), (660, y + 28))
    d.text(585, y + 50, "stop, normally closed", "m s")
    d.box(660, y + 6, 90, 44, "enable", "amplifier")


def servo(built: Electronics) -> str:
    """Converter, shift, servo amplifier with its monitor, divider, converter."""
    assert built.scales.command is not None
    assert built.scales.monitor is not None
    assert built.circuit.servo is not None
    n = named([*built.scales.command.parts.items(), *built.scales.monitor.parts.items()])
    limit_V = built.circuit.servo.input_V
    d = Drawing("From a converter of 0 to 3.3 V to a servo amplifier and back", 780, 510)
    d.box(20, 110, 110, 56, "DAC", "0 to 3.3 V", "MCP4921")
    d.wire((130, 135), (250, 135))
    d.amplifier(250, 120, "½")
    d.text(262, 165, "OPA2192, ±12 V", "s")
    d.wire((250, 105), (210, 105), (210, 40), (220, 40))
    d.across(220, 40, n["R1"])
    d.wire((280, 40), (340, 40), (340, 120), (310, 120))
    d.wire((210, 105), (150, 105), (150, 80))
    d.across(90, 60, n["R2"])
    d.wire((150, 60), (150, 105))
    d.text(50, 64, "3.3 V")
    d.wire((210, 105), (210, 190))
    d.dots((210, 105), (150, 105), (340, 120))
    d.down(210, 190, n["R3"], ends="ground")
    d.across(370, 120, "100")
    d.wire((340, 120), (370, 120))
    d.wire((430, 120), (520, 120))
    d.dots((470, 120))
    d.down(470, 120, "1n", ends="ground", capacitor=True)
    d.text(480, 108, f"±{limit_V:g} V", "s")
    d.box(520, 90, 110, 150, "ESCON", "analogue in", "", "", "", "", "monitor out")
    d.wire((630, 165), (690, 165))
    d.box(690, 140, 70, 50, "motor")
    d.wire((520, 220), (490, 220), (490, 290))
    d.across(430, 290, n["R4"])
    d.wire((430, 290), (130, 290))
    d.dots((400, 290), (340, 290), (270, 290))
    d.wire((400, 290), (400, 250), (390, 250))
    d.across(330, 250, n["R5"])
    d.text(290, 254, "3.3 V")
    if "R6" in n:
        d.down(400, 290, n["R6"], ends="ground")
    d.down(340, 290, "3n3", ends="ground", capacitor=True)
    d.box(243, 305, 54, 44, "BAT54S", "clamp")
    d.wire((270, 290), (270, 305))
    d.across(140, 290, "1k")
    d.box(20, 265, 110, 50, "ADC", "0 to 3.3 V")
    enable(d, 400)
    return d.done()


def bridge(built: Electronics) -> str:
    """Converter, PI stage, comparator, bridge, shunt amplifier, converter."""
    closed = built.scales.loop
    assert closed is not None
    assert built.circuit.bridge is not None
    n = named((("R7", closed.R7_ohm), ("R8", closed.R8_ohm), ("R9", closed.R9_ohm)))
    d = Drawing("A plain H-bridge with a shunt amplifier and a PI stage", 780, 510)
    d.box(20, 70, 110, 50, "DAC", "0 to 3.3 V")
    d.across(140, 95, n["R7"])
    d.wire((130, 95), (140, 95))
    d.wire((200, 95), (270, 95))
    d.amplifier(270, 110, "PI")
    d.text(282, 158, "OPA2192", "s")
    d.text(198, 130, "1.65 V", "s")
    d.wire((240, 125), (270, 125))
    d.wire((235, 95), (235, 40), (250, 40))
    d.across(250, 40, n["R9"])
    d.wire((310, 40), (325, 40))
    d._path("M325 40 v-11 v22 m8 -22 v22 m0 -11 h32")
    d.text(328, 66, f"C1 {1e9 * closed.C1_F:g}n", "m")
    d.wire((365, 40), (365, 110), (330, 110))
    d.wire((365, 110), (400, 110))
    d.amplifier(400, 125, "")
    d.text(440, 165, "TLV3501", "s")
    d.wire((370, 140), (400, 140))
    d.text(355, 182, f"triangle {built.circuit.bridge.triangle_V:g} V", "s")
    d.wire((460, 125), (500, 125))
    d.box(500, 90, 100, 90, "H-bridge", "legs in", "antiphase", f"{built.circuit.bridge.motor_V:g} V")
    d.wire((600, 110), (690, 110))
    d.box(690, 90, 70, 90, "motor")
    d.wire((690, 160), (660, 160))
    d._path("M620 153 h40 v14 h-40 z", ' class="b"')
    d.text(640, 146, f"{1e3 * built.circuit.bridge.shunt_ohm:g} mΩ", "m s")
    d.wire((620, 160), (600, 160))
    d.box(
        560,
        225,
        160,
        56,
        "INA240",
        f"gain {built.circuit.bridge.sense_gain:g}, about 1.65 V",
        "falls with the current",
    )
    d.wire((620, 160), (620, 225))
    d.wire((660, 160), (660, 225))
    d.wire((560, 253), (200, 253))
    d.across(140, 253, n["R8"])
    d.wire((140, 253), (135, 253), (135, 205), (235, 205), (235, 95))
    d.dots((235, 95), (365, 110), (480, 253), (420, 253))
    d.down(480, 253, "R6 1M", ends="ground")
    d.across(360, 300, "1k")
    d.wire((420, 253), (420, 300))
    d.wire((360, 300), (130, 300))
    d.down(300, 300, "10n", ends="ground", capacitor=True)
    d.dots((300, 300))
    d.box(20, 275, 110, 50, "ADC", "0 to 3.3 V")
    enable(d, 400)
    return d.done()


def drawings() -> dict[str, str]:
    """Text of each file by its name."""
    return {
        "circuit_servo.svg": servo(load_circuit(CIRCUITS["escon_re25"])[0]),
        "circuit_bridge.svg": bridge(load_circuit(CIRCUITS["bridge_re40"])[0]),
    }


def main(out: Annotated[Path, Option(help="folder of the manual's page")] = Path("docs/howto")) -> int:
    for name, text in drawings().items():
        (out / name).write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    run(main)
