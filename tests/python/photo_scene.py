"""A synthetic scene for tests of `tt3d photos`: an object on a table in a room, ray-cast in numpy.

The object is a box with a ball on it, all surfaces have random colours, and the true cameras and
masks are known. World: +Z up, the table is z = 0. Cameras: OpenCV axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

BOX_LOW, BOX_HIGH = np.array([-0.5, -0.35, 0.0]), np.array([0.5, 0.35, 0.6])
BALL, RADIUS = np.array([0.1, 0.0, 0.8]), 0.35
TABLE, WALL, CEILING = 2.2, 6.0, 5.0


@dataclass
class SceneView:
    """A picture with its truth."""

    pixels: np.ndarray  # [H,W,3] uint8 RGB
    mask: np.ndarray  # [H,W] bool
    rotation: np.ndarray  # world to camera
    translation: np.ndarray


class Noise:
    """Random colours in space: octaves of trilinear value noise."""

    def __init__(self, seed: int) -> None:
        random = np.random.default_rng(seed)
        self.cells = random.random((32, 32, 32, 3), np.float32)

    def at(self, points: np.ndarray, scale: float, octaves: int = 3) -> np.ndarray:
        total, weights = np.zeros(points.shape, np.float32), 0.0
        for octave in range(octaves):
            p = points * (scale * 2**octave) + 7.3 * octave
            base = np.floor(p).astype(int)
            f = (p - base)[..., None].astype(np.float32)
            value = np.zeros(points.shape, np.float32)
            for corner in range(8):
                offset = np.array([corner & 1, corner >> 1 & 1, corner >> 2 & 1])
                i = (base + offset) % 32
                w = np.prod(np.where(offset[:, None] == 1, f, 1 - f), axis=-2)
                value += w * self.cells[i[..., 0], i[..., 1], i[..., 2]]
            total += value * 0.7**octave
            weights += 0.7**octave
        return np.clip((total / weights - 0.5) * 2.2 + 0.5, 0, 1)


def slab(origin: np.ndarray, rays: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple:
    """Return entry and exit distances of rays through a box."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - origin) / rays, (high - origin) / rays
    return np.minimum(a, b).max(-1), np.maximum(a, b).min(-1)


def look_at(position: np.ndarray, target: np.ndarray, roll: float = 0.0) -> np.ndarray:
    """Return the rotation world to camera."""
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    turned = np.cos(roll) * right + np.sin(roll) * down
    return np.stack([turned, np.cross(forward, turned), forward])


def render(
    rotation: np.ndarray, position: np.ndarray, size: tuple[int, int], focal: float, gain: float = 1
) -> SceneView:
    """Ray-cast one picture of `size` (width, height)."""
    width, height = size
    y, x = np.mgrid[0:height, 0:width]
    local = np.stack(
        [(x + 0.5 - width / 2) / focal, (y + 0.5 - height / 2) / focal, np.ones(x.shape)], -1
    )
    rays = local @ rotation
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    near, far = slab(position, rays, BOX_LOW, BOX_HIGH)
    box = np.where((near < far) & (near > 0), near, np.inf)
    b = rays @ (position - BALL)
    root = b * b - ((position - BALL) ** 2).sum() + RADIUS**2
    ball = np.where(root > 0, -b - np.sqrt(np.maximum(root, 0)), np.inf)
    room_low, room_high = np.array([-WALL, -WALL, -2.0]), np.array([WALL, WALL, CEILING])
    room = slab(position, rays, room_low, room_high)[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        down = -position[2] / rays[..., 2]
    on_table = (np.abs(position + down[..., None] * rays)[..., :2] < TABLE).all(-1) & (down > 0)
    table = np.where(on_table, down, np.inf)
    depth = np.minimum(np.minimum(box, ball), np.minimum(room, table))
    points = position + depth[..., None] * rays
    mask = np.minimum(box, ball) <= depth
    colours = NOISES[0].at(points, 6.0) * [0.9, 0.45, 0.2]
    colours = np.where(
        (depth == table)[..., None], NOISES[1].at(points, 3) * [0.4, 0.5, 0.6], colours
    )
    colours = np.where((depth == room)[..., None], 0.3 + 0.5 * NOISES[2].at(points, 1.5), colours)
    shade = 0.75 + 0.25 * np.clip(points[..., 2:] / 1.2, 0, 1)
    pixels = np.clip(255 * gain * shade * colours, 0, 255).astype(np.uint8)
    return SceneView(pixels, mask, rotation, -rotation @ position)


NOISES = [Noise(seed) for seed in range(3)]


def ring(
    count: int,
    size: tuple[int, int] = (400, 300),
    elevations: tuple[float, ...] = (20, 42),
    seed: int = 0,
    gains: float = 0.0,
) -> list[SceneView]:
    """Render views all around, in rings of the elevations (degrees), with a hand's shake."""
    random = np.random.default_rng(seed)
    views = []
    for i in range(count):
        elevation = np.radians(elevations[i * len(elevations) // count])
        azimuth = 2 * np.pi * i * len(elevations) / count
        back = np.array(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
            ]
        )
        position = np.array([0, 0, 0.5]) + 3.2 * back + random.normal(size=3) * 0.05
        target = np.array([0, 0, 0.5]) + random.normal(size=3) * 0.04
        rotation = look_at(position, target, random.normal() * 0.03)
        gain = float(np.exp(gains * random.normal()))
        views.append(render(rotation, position, size, 1.1 * max(size), gain))
    return views


def rotation_errors(
    found: list[np.ndarray], true: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors of camera rotations in degrees after the best common rotation, and this
    rotation (found world to true world)."""
    total = sum(t.T @ f for t, f in zip(true, found, strict=True))
    u, _, v = np.linalg.svd(total)
    common = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
    errors = [
        np.degrees(np.arccos(np.clip((np.trace(t @ common @ f.T) - 1) / 2, -1, 1)))
        for t, f in zip(true, found, strict=True)
    ]
    return np.array(errors), common
