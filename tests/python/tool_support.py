"""Helpers for the tests of the tools: the program, and an asset without symmetry."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
BUILD = Path(os.environ.get("TT3D_BUILD", ROOT / "build/release"))
PROGRAM = BUILD / "tt3d"
TOY = ROOT / "tests/model/fixtures/toy_cnn.pt2"


def tt3d(*words: object, timeout: float = 500) -> subprocess.CompletedProcess[str]:
    """Run the program."""
    return subprocess.run(
        [PROGRAM, *map(str, words)], capture_output=True, text=True, timeout=timeout, cwd=ROOT
    )


def texture() -> np.ndarray:
    """Return a smooth texture that differs in every corner and channel."""
    y, x = np.mgrid[0:256, 0:256] / 255.0
    red = 0.2 + 0.6 * x
    green = 0.3 + 0.5 * y * (1 - 0.4 * x)
    blue = 0.5 + 0.3 * np.sin(6.2832 * (x + 2 * y))
    return np.round(255 * np.stack([red, green, blue], axis=2)).astype(np.uint8)


def write_asset(
    folder: Path, name: str = "asset", radii: tuple[float, ...] = (1, 0.8, 0.6)
) -> Path:
    """Write a closed, bumpy ellipsoid off the origin as OBJ, with uvs by angle and a seam."""
    rows, columns = 24, 48
    vertices, uvs, faces = [], [], []
    for i in range(rows + 1):
        for j in range(columns + 1):
            uvs.append((j / columns, 1 - i / rows))
    for i in range(rows + 1):
        for j in range(columns if 0 < i < rows else 1):
            a, b = np.pi * i / rows, 2 * np.pi * j / columns
            r = 1 + 0.15 * np.sin(2 * a) * np.cos(b) + 0.1 * np.sin(a) ** 2 * np.sin(2 * b)
            direction = np.array([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)])
            vertices.append(np.array([0.3, -0.2, 0.5]) + r * direction * radii)

    def vertex(i: int, j: int) -> int:
        if i == 0:
            return 1
        if i == rows:
            return len(vertices)
        return 2 + (i - 1) * columns + j % columns

    for i in range(rows):
        for j in range(columns):
            corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
            for triangle in ((0, 1, 2), (0, 2, 3)):
                at = [corners[k] for k in triangle]
                if len({vertex(*c) for c in at}) == 3:
                    faces.append([(vertex(*c), c[0] * (columns + 1) + c[1] + 1) for c in at])
    lines = [f"mtllib {name}.mtl", "usemtl object"]
    lines += ["v {:.7g} {:.7g} {:.7g}".format(*v) for v in vertices]
    lines += ["vt {:.7g} {:.7g}".format(*t) for t in uvs]
    lines += ["f " + " ".join(f"{v}/{t}" for v, t in f) for f in faces]
    (folder / f"{name}.mtl").write_text(f"newmtl object\nKd 1 1 1\nmap_Kd {name}.png\n")
    Image.fromarray(texture()).save(folder / f"{name}.png")
    (folder / f"{name}.obj").write_text("\n".join(lines) + "\n")
    return folder / f"{name}.obj"
