"""Make the sheet for the physical test: scale bar, turntable, distances, angles, lights.

    python print_sheet.py OUT.svg OBJECT TARGET SIZE_MM

The sheet is an A4 page in millimetres, to be printed at 100 %. At its distances the object fills
the same part of the picture as in `tt3d evaluate`.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from xml.etree import ElementTree

sys.path.insert(0, str(Path(__file__).resolve().parent))
import toolkit

WIDTH, HEIGHT, MARGIN = 210, 297, 18  # mm
LINE = {"stroke": "black", "stroke-width": "0.3"}
FIELD_OF_VIEW_DEG = 40  # of the default views


def add(parent: ElementTree.Element, tag: str, **attributes: object) -> ElementTree.Element:
    """Add an SVG element; underscores in attribute names stand for hyphens."""
    named = {name.replace("_", "-"): str(value) for name, value in attributes.items()}
    return ElementTree.SubElement(parent, tag, named)


def add_text(page: ElementTree.Element, x: float, y: float, words: str, **style: object) -> None:
    """Add a line of text; sizes are in millimetres."""
    add(page, "text", x=f"{x:g}", y=f"{y:g}", **{"font_size": 3.6, **style}).text = words


def add_scale_bar(page: ElementTree.Element, x: float, y: float, length: int) -> None:
    """Add a bar of centimetres, alternately black and white."""
    for k in range(0, length, 10):
        fill = ("black", "white")[k // 10 % 2]
        add(page, "rect", x=x + k, y=y, width=10, height=4, fill=fill, **LINE)
    for k in range(0, length + 1, 50):
        add_text(page, x + k - 1, y + 8.5, str(k), font_size=3)
    add_text(page, x + length + 4, y + 4, "mm: measure it before use")


def add_turntable(page: ElementTree.Element, x: float, y: float, radius: float) -> None:
    """Add the circle for the object, with a mark every 30 degrees."""
    add(page, "circle", cx=x, cy=y, r=radius, fill="none", **LINE)
    for degrees in range(0, 360, 30):
        a = math.radians(degrees)
        c, s = math.cos(a), -math.sin(a)
        (x1, y1), (x2, y2) = (
            (f"{x + r * c:.2f}", f"{y + r * s:.2f}") for r in (radius - 3, radius)
        )
        add(page, "line", x1=x1, y1=y1, x2=x2, y2=y2, **LINE)
        away = radius + 4.5
        add_text(page, x + away * c - 2.5, y + away * s + 1, f"{degrees}", font_size=3)
    add_text(page, x - 17, y + 1, "object here, front to 0", font_size=3.2)


def protocol(size_mm: float) -> list[str]:
    """Return the steps of the protocol, one a line."""
    radius = size_mm * math.sqrt(3) / 2  # that of a cube, the largest possible
    distance = radius / math.sin(math.radians(FIELD_OF_VIEW_DEG / 2)) / 0.95
    near, far = 0.95 * distance, 1.25 * distance
    return [
        f"Object: longest side {size_mm:g} mm. Camera {near:.0f} to {far:.0f} mm from its middle.",
        "Zoom so that the object fills one half to two thirds of the picture's height; no filters.",
        "Elevation: one turn each at -10 (or level), 15, 45 and 70 degrees, 20 s a turn.",
        "Lights: 1 daylight from a window, no direct sun; 2 room lamp; 3 both. No flash.",
        "Backgrounds: 1 white paper; 2 a table; 3 a shelf or a room; 4 grass or a floor.",
        "Lock focus, exposure and white balance; 30 frames a second or more; 1080p or more.",
        "One video a light and background. Write start, end and label of each take to a file:",
        "    start_seconds,end_seconds,label        e.g. 0,20,white paper",
        "Film the clean print in the same way: its classification is needed for comparison.",
        "Score: tt3d video-score VIDEO --target CLASS --victims MODEL... --backgrounds FILE",
    ]


def sheet(name: str, target: str, size_mm: float) -> str:
    """Return the page as SVG."""
    page = ElementTree.Element("svg", {
        "xmlns": "http://www.w3.org/2000/svg", "width": f"{WIDTH}mm", "height": f"{HEIGHT}mm",
        "viewBox": f"0 0 {WIDTH} {HEIGHT}", "font-family": "sans-serif",
    })  # fmt: skip
    add(page, "rect", width="100%", height="100%", fill="white")
    title = f"Capture sheet: {name}" + (f", attacked towards {target}" if target else "")
    add_text(page, MARGIN, 24, title, font_size=6, font_weight="bold")
    add_scale_bar(page, MARGIN, 34, 100)
    add_turntable(page, WIDTH / 2, 108, 45)
    for i, line in enumerate(protocol(size_mm)):
        add_text(page, MARGIN, 178 + 6.5 * i, line)
    for i, field in enumerate(("Date", "Printer and material", "Camera", "Light", "Person")):
        y = 252 + 7.5 * i
        add_text(page, MARGIN, y, field + ":")
        add(page, "line", x1=70, y1=y, x2=WIDTH - MARGIN, y2=y, stroke="black", stroke_width=0.2)
    ElementTree.indent(page)
    return ElementTree.tostring(page, encoding="unicode") + "\n"


def work(arguments: list[str]) -> None:
    """Write the sheet."""
    out, name, target, size_mm = arguments
    Path(out).write_text(sheet(name, target, float(size_mm)))


if __name__ == "__main__":
    toolkit.main(work)
