"""The sheet for the physical test: scale bar, turntable, distances, angles, lights, backgrounds.

    python print_sheet.py OUT.svg OBJECT TARGET SIZE_MM

An A4 page in millimetres, to be printed at 100 %. The distance is that of the default views: the
object fills the same part of the picture as in `tt3d evaluate`.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from xml.sax.saxutils import escape

sys.path.insert(0, str(Path(__file__).resolve().parent))
import toolkit

WIDTH, HEIGHT, MARGIN = 210, 297, 18  # mm
LINE = 'stroke="black" stroke-width="0.3"'
FIELD_OF_VIEW_DEG = 40  # of the default views


def text(x: float, y: float, words: str, size: float = 3.6, weight: str = "normal") -> str:
    """A line of text; sizes in millimetres."""
    return (
        f'<text x="{x:g}" y="{y:g}" font-size="{size:g}" font-weight="{weight}">'
        f"{escape(words)}</text>"
    )


def scale_bar(x: float, y: float, length: int) -> list[str]:
    """Centimetres, black and white in turn."""
    parts = [
        f'<rect x="{x + k}" y="{y}" width="10" height="4" fill="{("black", "white")[k // 10 % 2]}"'
        f" {LINE}/>"
        for k in range(0, length, 10)
    ]
    parts += [text(x + k - 1, y + 8.5, str(k), 3) for k in range(0, length + 1, 50)]
    return [*parts, text(x + length + 4, y + 4, "mm: measure it before use")]


def turntable(x: float, y: float, radius: float) -> list[str]:
    """Where the object stands: a mark every 30 degrees."""
    parts = [f'<circle cx="{x}" cy="{y}" r="{radius}" fill="none" {LINE}/>']
    for degrees in range(0, 360, 30):
        a = math.radians(degrees)
        c, s = math.cos(a), -math.sin(a)
        parts.append(
            f'<line x1="{x + (radius - 3) * c:.2f}" y1="{y + (radius - 3) * s:.2f}" '
            f'x2="{x + radius * c:.2f}" y2="{y + radius * s:.2f}" {LINE}/>'
        )
        away = radius + 4.5
        parts.append(text(x + away * c - 2.5, y + away * s + 1, f"{degrees}", 3))
    return [*parts, text(x - 17, y + 1, "object here, front to 0", 3.2)]


def protocol(size_mm: float) -> list[str]:
    """The steps, one a line."""
    radius = size_mm * math.sqrt(3) / 2  # a cube's, the largest there is
    distance = radius / math.sin(math.radians(FIELD_OF_VIEW_DEG / 2)) / 0.95
    near, far = 0.95 * distance, 1.25 * distance
    return [
        f"Object: longest side {size_mm:g} mm. Camera {near:.0f} to {far:.0f} mm from its middle.",
        "Zoom so that the object fills one half to two thirds of the picture's height; no filters.",
        "Elevation: one turn each at -10 (or level), 15, 45 and 70 degrees, 20 s a turn.",
        "Lights: 1 daylight from a window, no direct sun; 2 room lamp; 3 both. No flash.",
        "Backgrounds: 1 white paper; 2 a table; 3 a shelf or a room; 4 grass or a floor.",
        "Lock focus, exposure and white balance; 30 frames a second or more; 1080p or more.",
        "One video a light and background. Write start, end and label of each take in a file:",
        "    start_seconds,end_seconds,label        e.g. 0,20,white paper",
        "Film the clean print in the same way: what it is taken for counts as well.",
        "Score: tt3d video-score VIDEO --target CLASS --victims MODEL... --backgrounds FILE",
    ]


def sheet(name: str, target: str, size_mm: float) -> str:
    """The page as SVG."""
    title = f"Capture sheet: {name}" + (f", attacked towards {target}" if target else "")
    parts = [text(MARGIN, 24, title, 6, "bold")]
    parts += scale_bar(MARGIN, 34, 100)
    parts += turntable(WIDTH / 2, 108, 45)
    for i, line in enumerate(protocol(size_mm)):
        parts.append(text(MARGIN, 178 + 6.5 * i, line))
    for i, field in enumerate(("Date", "Printer and material", "Camera", "Light", "Person")):
        y = 252 + 7.5 * i
        parts.append(text(MARGIN, y, field + ":"))
        parts.append(
            f'<line x1="70" y1="{y}" x2="{WIDTH - MARGIN}" y2="{y}" stroke="black" '
            'stroke-width="0.2"/>'
        )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}mm" height="{HEIGHT}mm" '
        f'viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif">\n'
        '<rect width="100%" height="100%" fill="white"/>\n' + "\n".join(parts) + "\n</svg>\n"
    )


def work(arguments: list[str]) -> None:
    """Writes the sheet."""
    out, name, target, size_mm = arguments
    Path(out).write_text(sheet(name, target, float(size_mm)))


if __name__ == "__main__":
    toolkit.main(work)
