"""A COLMAP model: cameras, views and sparse points, read from and written as text."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tt3d_tools import toolkit

FILES = ("cameras.txt", "images.txt", "points3D.txt")


@dataclass
class Lens:
    """Intrinsics in pixels; pixel centres are at .5."""

    model: str
    width: int
    height: int
    parameters: list[float]

    def matrix(self) -> tuple[float, float, float, float]:
        """Return fx, fy, cx, cy."""
        p = self.parameters
        if self.model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"):
            return p[0], p[0], p[1], p[2]
        return p[0], p[1], p[2], p[3]

    def radial(self) -> tuple[float, float]:
        """Return k1 and k2."""
        p = self.parameters
        if self.model == "SIMPLE_RADIAL":
            return p[3], 0.0
        if self.model == "RADIAL":
            return p[3], p[4]
        if self.model in ("OPENCV", "FULL_OPENCV"):
            return p[4], p[5]
        return 0.0, 0.0


@dataclass
class View:
    """A registered picture: x_camera = rotation x_world + translation; x right, y down, z ahead."""

    name: str
    camera: int
    rotation: np.ndarray
    translation: np.ndarray
    keypoints: np.ndarray  # [N,2] pixels
    points: np.ndarray  # [N] index of the sparse point, -1: none

    @property
    def position(self) -> np.ndarray:
        """The camera's position in the world."""
        return -self.rotation.T @ self.translation


@dataclass
class Model:
    """A sparse reconstruction."""

    lenses: dict[int, Lens]
    views: list[View]
    points: np.ndarray  # [P,3]
    colours: np.ndarray  # [P,3] uint8
    errors: np.ndarray  # [P] pixels
    track_lengths: np.ndarray = field(default_factory=lambda: np.zeros(0, int))  # [P] views

    def lens(self, view: View) -> Lens:
        """Return the lens of a view."""
        return self.lenses[view.camera]

    def project(self, view: View, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return pixels [N,2] and depths [N] of world points; pixels are NaN behind the camera."""
        local = points @ view.rotation.T + view.translation
        depth = local[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            xy = np.where(depth[:, None] > 1e-9, local[:, :2] / depth[:, None], np.nan)
        fx, fy, cx, cy = self.lens(view).matrix()
        k1, k2 = self.lens(view).radial()
        r2 = (xy**2).sum(1, keepdims=True)
        # Beyond the picture the polynomial may turn back; such points stay undistorted.
        grow = np.where(r2 < 1.5, 1 + k1 * r2 + k2 * r2**2, 1.0)
        return xy * grow * [fx, fy] + [cx, cy], depth

    def rotated(self, rotation: np.ndarray) -> Model:
        """Return the model with its world turned: x_new = rotation x_old."""
        views = [
            View(v.name, v.camera, v.rotation @ rotation.T, v.translation, v.keypoints, v.points)
            for v in self.views
        ]
        points = self.points @ rotation.T
        return Model(self.lenses, views, points, self.colours, self.errors, self.track_lengths)


def quaternion_matrix(q: np.ndarray) -> np.ndarray:
    """Return the rotation of a quaternion w x y z."""
    w, x, y, z = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def matrix_quaternion(m: np.ndarray) -> np.ndarray:
    """Return the quaternion w x y z, w >= 0, of a rotation (Shepperd's method)."""
    k = np.array(
        [
            [m[0, 0] - m[1, 1] - m[2, 2], 0, 0, 0],
            [m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], 0, 0],
            [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1], 0],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], np.trace(m)],
        ]
    )
    values, vectors = np.linalg.eigh(k / 3)
    x, y, z, w = vectors[:, np.argmax(values)]
    q = np.array([w, x, y, z])
    return -q if w < 0 else q


def lines_of(path: Path) -> list[str]:
    """Return the lines of a text file that are not comments; empty lines are kept."""
    return [line for line in path.read_text().splitlines() if not line.startswith("#")]


def read_model(folder: Path) -> Model:
    """Read a model; a binary one is converted to text by colmap. Raise InputProblem."""
    try:
        if (folder / "cameras.txt").exists():
            return read_text(folder)
        return read_binary(folder)
    except (OSError, ValueError, IndexError, KeyError) as error:
        raise toolkit.InputProblem(f"{folder}: is not a COLMAP model: {error}") from error


def read_binary(folder: Path) -> Model:
    """Convert a binary model in a temporary folder and read it."""
    import tempfile

    with tempfile.TemporaryDirectory() as text:
        command = ["colmap", "model_converter", "--input_path", str(folder)]
        toolkit.run_checked(
            [*command, "--output_path", text, "--output_type", "TXT"], "colmap model_converter"
        )
        return read_text(Path(text))


def read_text(folder: Path) -> Model:
    """Read cameras.txt, images.txt and points3D.txt."""
    lenses = {}
    for line in filter(None, lines_of(folder / "cameras.txt")):
        number, model, width, height, *parameters = line.split()
        lens = Lens(model, int(width), int(height), [float(p) for p in parameters])
        lenses[int(number)] = lens
    rows = [line.split() for line in filter(None, lines_of(folder / "points3D.txt"))]
    index = {int(row[0]): i for i, row in enumerate(rows)}
    points = np.array([[float(x) for x in row[1:4]] for row in rows]).reshape(-1, 3)
    colours = np.array([[int(x) for x in row[4:7]] for row in rows], np.uint8).reshape(-1, 3)
    errors = np.array([float(row[7]) for row in rows])
    lengths = np.array([(len(row) - 8) // 2 for row in rows], int)
    views = []
    lines = lines_of(folder / "images.txt")
    while lines and not lines[-1].strip():
        lines.pop()
    for i in range(0, len(lines), 2):
        head = lines[i].split(maxsplit=9)
        values = np.array([float(x) for x in head[1:8]])
        data = np.array(lines[i + 1].split() if i + 1 < len(lines) else [], float).reshape(-1, 3)
        ids = np.array([index.get(int(n), -1) for n in data[:, 2]], int)
        rotation = quaternion_matrix(values[:4])
        views.append(View(head[9], int(head[8]), rotation, values[4:], data[:, :2], ids))
    views.sort(key=lambda view: view.name)
    return Model(lenses, views, points, colours, errors, lengths)


def write_text(model: Model, folder: Path) -> None:
    """Write a model as text; views and points get new numbers from 1."""
    folder.mkdir(parents=True, exist_ok=True)
    out = []
    for number, lens in sorted(model.lenses.items()):
        parameters = " ".join(f"{p:.10g}" for p in lens.parameters)
        out.append(f"{number} {lens.model} {lens.width} {lens.height} {parameters}\n")
    (folder / "cameras.txt").write_text("".join(out))
    tracks: list[list[str]] = [[] for _ in model.points]
    out = []
    for number, view in enumerate(model.views, 1):
        q = " ".join(f"{x:.12g}" for x in matrix_quaternion(view.rotation))
        t = " ".join(f"{x:.12g}" for x in view.translation)
        out.append(f"{number} {q} {t} {view.camera} {view.name}\n")
        kept = np.flatnonzero(view.points >= 0)
        out.append(
            " ".join(
                f"{view.keypoints[i, 0]:.2f} {view.keypoints[i, 1]:.2f} {view.points[i] + 1}"
                for i in kept
            )
            + "\n"
        )
        for row, i in enumerate(kept):
            tracks[view.points[i]].append(f"{number} {row}")
    (folder / "images.txt").write_text("".join(out))
    out = []
    for i, (p, c, e) in enumerate(zip(model.points, model.colours, model.errors, strict=True)):
        place = f"{p[0]:.9g} {p[1]:.9g} {p[2]:.9g} {c[0]} {c[1]} {c[2]} {e:.4f}"
        out.append(f"{i + 1} {place} {' '.join(tracks[i])}\n")
    (folder / "points3D.txt").write_text("".join(out))
