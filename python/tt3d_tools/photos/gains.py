"""Exposure and white balance of each photograph, from the object's sparse points.

A point has one colour, so the colours of its pictures differ by the photographs' gains. The
logarithm of a linear colour is the sum of the point's and the photograph's; both are found in turn
by medians, which highlights and shadows do not move. The gains' mean is 1.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from tt3d_tools.photos.sparse import Model

DARKEST, BRIGHTEST = 0.004, 0.9  # linear levels whose ratio means something
FEWEST = 20  # points of a photograph; fewer tell nothing
LARGEST = 4.0  # gain, and the inverse of the smallest


def to_linear(levels: np.ndarray) -> np.ndarray:
    """Return linear light of sRGB levels in [0,1]."""
    return np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)


def observations(model: Model, images: Path, chosen: np.ndarray) -> list[np.ndarray]:
    """Return for each view the rows (point, log r, log g, log b) of the chosen points."""
    rows = []
    for view in model.views:
        pixels = cv2.imread(str(images / view.name))[:, :, ::-1]
        smooth = cv2.GaussianBlur(pixels, (0, 0), 2)
        kept = (view.points >= 0) & chosen[np.maximum(view.points, 0)]
        at = view.keypoints[kept].astype(int)
        inside = (at >= 0).all(1) & (at < [pixels.shape[1], pixels.shape[0]]).all(1)
        linear = to_linear(smooth[at[inside, 1], at[inside, 0]] / 255.0)
        good = ((linear > DARKEST) & (linear < BRIGHTEST)).all(1)
        points = view.points[kept][inside][good]
        rows.append(np.column_stack([points, np.log(linear[good])]))
    return rows


def medians(values: np.ndarray, groups: np.ndarray, count: int) -> np.ndarray:
    """Return the median of each group's rows [count,3]; zero for an empty group."""
    out = np.zeros((count, 3))
    order = np.argsort(groups, kind="stable")
    for part in np.split(order, np.flatnonzero(np.diff(groups[order])) + 1):
        if len(part):
            out[groups[part[0]]] = np.median(values[part], 0)
    return out


def find_gains(model: Model, images: Path, chosen: np.ndarray) -> dict[str, list[float]]:
    """Return the factors [r,g,b] that even the linear colours of each photograph, by name."""
    rows = observations(model, images, chosen)
    points = np.concatenate([r[:, 0] for r in rows]).astype(int)
    views = np.concatenate([np.full(len(r), i) for i, r in enumerate(rows)])
    logs = np.concatenate([r[:, 1:] for r in rows])
    gains = np.zeros((len(rows), 3))
    for _ in range(20):
        colours = medians(logs + gains[views], points, len(model.points))
        gains = medians(colours[points] - logs, views, len(rows))
        gains[[len(r) < FEWEST for r in rows]] = 0
        gains -= gains.mean(0)
    factors = np.clip(np.exp(gains), 1 / LARGEST, LARGEST)
    return {v.name: np.round(f, 4).tolist() for v, f in zip(model.views, factors, strict=True)}
