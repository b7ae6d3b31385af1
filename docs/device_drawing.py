"""The drawing of motor, stylus, hand and surface with their signs: this script writes explanation/device.svg."""

from pathlib import Path

FILE = Path(__file__).parent / "explanation" / "device.svg"
WIDTH, HEIGHT, LINE = 880, 330, 170  # LINE: height of the masses' middles
HEAD = f"""<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}"
 font-family="sans-serif" font-size="14">
<!-- Written by docs/device_drawing.py: do not edit. -->
<style>.l{{stroke:#333;fill:none;stroke-width:1.6}}.m{{stroke:#333;fill:#e8eef4;stroke-width:1.6}}
.a{{stroke:#b03a00;stroke-width:2.2;fill:none}}.t{{fill:#b03a00}}text{{fill:#222}}</style>
<defs><marker id="p" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">
<path d="M0 0 8 4 0 8z" fill="#b03a00"/></marker></defs>
<rect width="{WIDTH}" height="{HEIGHT}" fill="#fff"/>"""


def text(x: float, y: float, words: str, style: str = "") -> str:
    return f'<text x="{x}" y="{y}" text-anchor="middle"{style}>{words}</text>'


def mass(x: float, width: float, height: float, *words: str) -> list[str]:
    """A box around the line of masses, named inside."""
    box = f'<rect class="m" x="{x}" y="{LINE - height / 2}" width="{width}" height="{height}" rx="4"/>'
    first = LINE + 5 - 9 * (len(words) - 1)
    return [box, *(text(x + width / 2, first + 18 * j, word) for j, word in enumerate(words))]


def joint(x: float, width: float, words: str) -> list[str]:
    """A spring above a damper, from x on."""
    teeth = "".join(f" l{width / 12} {9 if j % 2 else -9}" for j in range(1, 9))
    spring = f'<path class="l" d="M{x} {LINE - 18} h{width / 6}{teeth} H{x + width}"/>'
    cylinder, piston, end = x + 0.35 * width, x + 0.55 * width, x + 0.7 * width
    damper = (
        f'<path class="l" d="M{x} {LINE + 18} H{cylinder} M{end} {LINE + 8} H{cylinder} v20 H{end}'
        f' M{piston} {LINE + 10} v16 M{piston} {LINE + 18} H{x + width}"/>'
    )
    return [spring, damper, text(x + width / 2, LINE - 42, words)]


def arrow(path: str, x: float, y: float, words: str) -> list[str]:
    """A direction that counts as positive, and its name."""
    return [f'<path class="a" marker-end="url(#p)" d="{path}"/>', text(x, y, words, ' class="t"')]


def drawing() -> str:
    """The whole drawing; the way out of the object is to the right."""
    parts = [
        HEAD,
        f'<path d="M0 {LINE - 80} h70 v160 H0z" fill="#d9c7a8" stroke="#333"/>',
        text(35, LINE + 5, "object"),
        text(70, LINE + 104, "surface, z = 0"),
        f'<path class="m" d="M100 {LINE} l34 -14 v28z"/>',
        *mass(134, 96, 44, "stylus"),
        text(182, LINE + 42, "accelerometer"),
        *joint(230, 110, "skin (grip)"),
        *mass(340, 80, 44, "hand"),
        *joint(420, 110, "arm (grip)"),
        f'<path class="l" d="M530 {LINE - 34} v68" stroke-width="3"/>',
        text(566, LINE - 5, "intended"),
        text(566, LINE + 13, "motion"),
        f'<path class="l" d="M182 {LINE + 50} V262 H280 h14 l6 -9 12 18 12 -18 12 18 12 -18 6 9 H400"/>',
        text(335, 300, "transmission"),
        '<rect class="m" x="400" y="238" width="180" height="48" rx="4"/>',
        text(490, 258, "motor, encoder"),
        text(490, 276, "k_f: newton per ampere"),
        '<rect class="m" x="660" y="238" width="140" height="48" rx="4"/>',
        text(730, 258, "current amplifier"),
        text(730, 276, "delay, then pole"),
        *arrow("M150 60 h90", 200, 52, "z, y, a, r &gt; 0: out of the object"),
        *arrow("M212 112 h-60", 186, 104, "incoming speed v"),
        *arrow("M380 118 v26", 380, 112, "grip force f"),
        *arrow("M660 262 H586", 622, 230, "i &gt; 0: pushes out"),
        *arrow("M846 262 H806", 838, 232, "command c"),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


if __name__ == "__main__":
    FILE.write_text(drawing(), encoding="utf-8", newline="\n")
