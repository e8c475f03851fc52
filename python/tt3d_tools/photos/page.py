"""Draw capture.html: photographs with masks, cameras from above and from the side, advice.

    python page.py JOB.json

The job has `capture` (the folder), `quality` (what tt3d measured), `views` (camera positions and
axes in the object's frame), `floor` (height in that frame, or null) and `out`.
"""

from __future__ import annotations

import base64
import html
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tt3d_tools import toolkit

THUMB = 220  # pixels, height of a photograph on the page

STYLE = """
body { font: 15px/1.5 sans-serif; margin: 2em auto; max-width: 1200px; padding: 0 1em; }
figure { display: inline-block; margin: 4px; vertical-align: top; }
figcaption { font-size: 12px; color: #444; max-width: 320px; overflow-wrap: anywhere; }
figure.bad { outline: 3px solid #c22; }
table { border-collapse: collapse; } td { padding: 2px 16px 2px 0; }
li { margin: 4px 0; } .plots svg { width: 48%; border: 1px solid #ccc; }
"""


def encoded(picture: Any) -> str:
    """Return an img tag with a JPEG of BGR pixels inside."""
    import cv2

    done, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 80])
    assert done
    return f'<img src="data:image/jpeg;base64,{base64.b64encode(data).decode()}" alt="">'


def drawn_photograph(folder: Path, name: str) -> str:
    """Return a photograph with its mask: the background dark, a red line around the object."""
    import cv2
    import numpy as np

    path = folder / name
    pixels = cv2.imread(str(path))
    if pixels is None:
        return ""
    scale = THUMB / pixels.shape[0]
    small = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    stem = Path(name).stem
    for mask_name in (f"masks/{Path(name).name}.png", f"masks/{stem}.png"):
        mask = cv2.imread(str(folder / mask_name), cv2.IMREAD_GRAYSCALE)
        if mask is None:
            continue
        inside = cv2.resize(mask, small.shape[1::-1], interpolation=cv2.INTER_AREA) > 127
        small[~inside] = small[~inside] // 3
        edge = cv2.dilate(inside.astype(np.uint8), np.ones((3, 3))) > inside
        small[edge] = (0, 0, 255)
        break
    return encoded(small)


def plot(views: list[dict[str, Any]], axes: tuple[int, int], title: str, floor: Any) -> str:
    """Return an SVG of the cameras as arrows around the unit circle of the object."""
    extent = 1.15 * max([1.5, *(abs(v["position"][k]) for v in views for k in axes)])
    marks = []
    for view in views:
        x, y = view["position"][axes[0]], -view["position"][axes[1]]
        dx, dy = view["forward"][axes[0]], -view["forward"][axes[1]]
        length = 0.12 * extent
        colour = "#c22" if view["problem"] else "#246"
        marks.append(
            f'<line x1="{x:.3f}" y1="{y:.3f}" x2="{x + length * dx:.3f}" '
            f'y2="{y + length * dy:.3f}" '
            f'stroke="{colour}" stroke-width="{0.012 * extent:.4f}"/>'
            f'<circle cx="{x:.3f}" cy="{y:.3f}" r="{0.018 * extent:.4f}" fill="{colour}">'
            f"<title>{html.escape(view['name'])}</title></circle>"
        )
    if floor is not None and axes[1] == 2:
        marks.append(
            f'<line x1="{-extent:.3f}" x2="{extent:.3f}" y1="{-floor:.3f}" y2="{-floor:.3f}" '
            f'stroke="#a70" stroke-width="{0.008 * extent:.4f}"/>'
        )
    marks.append(
        f'<circle r="0.95" fill="none" stroke="#888" stroke-width="{0.006 * extent:.4f}"/>'
        f'<text x="{-0.97 * extent:.3f}" y="{-0.9 * extent:.3f}" '
        f'font-size="{0.07 * extent:.3f}">{title}</text>'
    )
    box = f"{-extent:.3f} {-extent:.3f} {2 * extent:.3f} {2 * extent:.3f}"
    return f'<svg viewBox="{box}">{"".join(marks)}</svg>'


def figures_table(quality: dict[str, Any], facts: list[tuple[str, str]]) -> str:
    """Return the table of measured figures."""
    low, high = quality["elevations_deg"]
    rows = [
        *facts,
        ("agreement of the masks with their hull (median)", f"{quality['hull_overlap']:.3f}"),
        ("directions above the horizon seen", f"{100 * quality['coverage']:.0f} %"),
        ("largest gap around the object", f"{quality['largest_gap_deg']:.0f} degrees"),
        ("elevations of the cameras", f"{low:.0f} to {high:.0f} degrees"),
        ("sharpness (0 blurred, 1 sharp; median)", f"{quality['sharpness']:.2f}"),
        ("spread of the exposure", f"{quality['exposure_spread']:.2f} stops"),
    ]
    cells = "".join(f"<tr><td>{html.escape(k)}</td><td>{html.escape(v)}</td></tr>" for k, v in rows)
    return f"<table>{cells}</table>"


def make_page(job: dict[str, Any]) -> str:
    """Return the page."""
    quality, folder = job["quality"], Path(job["capture"])
    photographs = []
    for number, view in enumerate(quality["views"]):
        toolkit.progress(number + 1, len(quality["views"]))
        bad = ' class="bad"' if view["problem"] else ""
        text = f"{view['name']}: overlap {view['hull_overlap']:.2f}"
        if view["problem"]:
            text += f" - {view['problem']}"
        picture = drawn_photograph(folder, view["name"])
        photographs.append(
            f"<figure{bad}>{picture}<figcaption>{html.escape(text)}</figcaption></figure>"
        )
    advice = "".join(f"<li>{html.escape(line)}</li>" for line in quality["advice"])
    advice = f"<ul>{advice}</ul>" if advice else "<p>Nothing to improve was found.</p>"
    facts = [(str(key), str(value)) for key, value in job["facts"]]
    floor = "" if job["floor"] is None else " The brown line is the support plane (--floor)."
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>Capture</title>'
        f"<style>{STYLE}</style></head><body>"
        f"<h1>Capture of {len(quality['views'])} photographs</h1>"
        f"<h2>Advice</h2>{advice}<h2>Figures</h2>{figures_table(quality, facts)}"
        "<h2>Cameras</h2><p>The circle is the ball around the object. Cameras with a bad mask are "
        f'red.{floor}</p><div class="plots">'
        f"{plot(job['views'], (0, 1), 'from above', job['floor'])} "
        f"{plot(job['views'], (0, 2), 'from the side', job['floor'])}</div>"
        "<h2>Photographs and masks</h2><p>The object is bright inside the red line. Replace a bad "
        "mask by your own in masks/ (white is the object), and run the same command again.</p>"
        f"{''.join(photographs)}</body></html>\n"
    )


def work(arguments: list[str]) -> None:
    """Draw the page of a job."""
    (path,) = arguments
    job = toolkit.read_job(path)
    toolkit.need_package("cv2", "the page of a capture", "opencv-contrib-python-headless")
    out = Path(job["out"])
    part = out.with_name(out.name + ".part")
    part.write_text(make_page(job))
    part.replace(out)


if __name__ == "__main__":
    toolkit.main(work)
