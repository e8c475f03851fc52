"""Step 3: the world's up direction, the object's place and the plane on which it stands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tt3d_tools.photos.sparse import Model

PLANE_TILT_DEG = 12.0  # largest angle between the support plane and the cameras' horizontal
PLANE_POINTS = 60  # fewest points on a support plane
PLANE_SHARE = 0.04  # fewest points on it, of those near the object
BELOW_SHARE = 0.03  # most points below it, of those near the object


@dataclass
class Place:
    """Where the object is: the ball that the cameras look at, and the support plane z = floor."""

    centre: np.ndarray
    radius: float
    distance: float  # median distance of the cameras
    floor: float | None
    bottom: float | None = None  # without a floor: where the object's points end


def camera_up(model: Model) -> np.ndarray:
    """Return the unit up direction from the cameras alone.

    A camera that is not rolled has a horizontal x axis, whatever its elevation. So the up direction
    is the one nearest to perpendicular to all x axes, if the cameras look in different directions;
    the mean of the cameras' up axes leans if the rings are not complete.
    """
    across = np.stack([view.rotation[0] for view in model.views])
    mean = -np.stack([view.rotation[1] for view in model.views]).mean(0)
    mean /= np.linalg.norm(mean)
    weights = np.ones(len(across))
    up = mean
    for _ in range(10):
        values, vectors = np.linalg.eigh((across * weights[:, None]).T @ across / weights.sum())
        if values[1] < 0.1:  # all cameras look the same way: the axes leave a plane of directions
            return mean
        up = vectors[:, 0] * np.sign(vectors[:, 0] @ mean)
        weights = 1 / (1 + (np.abs(across @ up) / np.sin(np.radians(5))) ** 2)
    far = np.degrees(np.arccos(np.clip(up @ mean, -1, 1))) > 40
    return mean if far else up


def rotation_to_z(up: np.ndarray) -> np.ndarray:
    """Return the smallest rotation that turns `up` to +Z."""
    z = np.array([0.0, 0.0, 1.0])
    axis = np.cross(up, z)
    cosine = float(up @ z)
    if cosine < -1 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + k + k @ k / (1 + cosine)


def meeting_point(model: Model) -> np.ndarray:
    """Return the point nearest to all cameras' axes; axes that miss it count less."""
    origins = np.stack([view.position for view in model.views])
    axes = np.stack([view.rotation[2] for view in model.views])
    weights = np.ones(len(axes))
    point = origins.mean(0)
    for _ in range(10):
        flat = np.eye(3) - axes[:, :, None] * axes[:, None, :]
        a = (weights[:, None, None] * flat).sum(0)
        b = (weights[:, None, None] * flat @ origins[:, :, None]).sum(0)[:, 0]
        point = np.linalg.solve(a + 1e-9 * np.trace(a) * np.eye(3), b)
        offset = point - origins
        miss = np.linalg.norm(np.cross(offset, axes), axis=1) / np.linalg.norm(offset, axis=1)
        weights = 1 / (1 + (miss / 0.1) ** 2)
    return point


def find_place(model: Model) -> Place:
    """Return the ball that fills the view of the middle camera; the floor is not known yet."""
    centre = meeting_point(model)
    distances, reaches = [], []
    for view in model.views:
        lens = model.lens(view)
        fx = lens.matrix()[0]
        distance = float(np.linalg.norm(centre - view.position))
        distances.append(distance)
        reaches.append(distance * np.sin(np.arctan(0.5 * min(lens.width, lens.height) / fx)))
    return Place(centre, float(np.median(reaches)), float(np.median(distances)), None)


def find_plane(model: Model, place: Place) -> tuple[np.ndarray, float] | None:
    """Return unit normal and offset (normal x = offset) of the support plane, if there is one.

    It is nearly horizontal, below the point that the cameras look at and below all cameras, and has
    hardly any points below it.
    """
    points = model.points
    near = np.linalg.norm((points - place.centre)[:, :2], axis=1) < 1.6 * place.radius
    lowest_camera = min(view.position[2] for view in model.views)
    near &= points[:, 2] < min(lowest_camera, place.centre[2] + place.radius)
    near &= points[:, 2] > place.centre[2] - 2.5 * place.radius
    p = points[near]
    if len(p) < PLANE_POINTS:
        return None
    tolerance = 0.02 * place.radius
    tangent = np.tan(np.radians(PLANE_TILT_DEG))
    random = np.random.default_rng(0)
    low = p[p[:, 2] < place.centre[2]]
    if len(low) < PLANE_POINTS:
        return None
    best, best_score = None, 0.0
    for _ in range(2000):
        a, b, c = low[random.integers(len(low), size=3)]
        normal = np.cross(b - a, c - a)
        if abs(normal[2]) < 1e-12 or np.hypot(*normal[:2]) > tangent * abs(normal[2]):
            continue
        normal = normal / np.linalg.norm(normal) * np.sign(normal[2])
        height = p @ normal - a @ normal
        inliers = np.abs(height) < tolerance
        below = (height < -3 * tolerance).sum()
        # Points that spread widely make a plane, a clump on the object does not.
        flat = p[inliers][:, :2]
        spread = np.sqrt(max(0.0, np.linalg.eigvalsh(np.cov(flat.T))[0])) if len(flat) > 3 else 0.0
        score = (len(flat) - 2 * below) * min(1.0, spread / (0.3 * place.radius))
        if score > best_score:
            best, best_score = (normal, float(a @ normal)), score
    if best is None:
        return None
    for _ in range(5):
        inliers = np.abs(p @ best[0] - best[1]) < tolerance
        middle = p[inliers].mean(0)
        _, _, axes = np.linalg.svd(p[inliers] - middle, full_matrices=False)
        normal = axes[2] * np.sign(axes[2][2])
        best = (normal, float(middle @ normal))
    height = p @ best[0] - best[1]
    inliers = (np.abs(height) < tolerance).sum()
    below = (height < -3 * tolerance).sum()
    tilt = np.degrees(np.arccos(np.clip(best[0][2], -1, 1)))
    enough = inliers >= max(PLANE_POINTS, PLANE_SHARE * len(p))
    if not enough or below > BELOW_SHARE * len(p) or tilt > PLANE_TILT_DEG:
        return None
    return best


def stand(model: Model, up: str) -> tuple[Model, dict[str, object]]:
    """Return the model with +Z up, and what was done: the method, the rotation, angles in degrees.

    `up` is "auto" or an axis of the model's world: x, y, z, -x, -y or -z.
    """
    if up != "auto":
        axis = np.eye(3)["xyz".index(up[-1])] * (-1 if up.startswith("-") else 1)
        rotation = rotation_to_z(axis)
        return model.rotated(rotation), {"method": up, "rotation": rotation}
    rotation = rotation_to_z(camera_up(model))
    turned = model.rotated(rotation)
    facts: dict[str, object] = {"method": "cameras"}
    plane = find_plane(turned, find_place(turned))
    if plane is not None:
        lean = rotation_to_z(plane[0])
        facts["method"] = "cameras and support plane"
        facts["plane_tilt_deg"] = float(np.degrees(np.arccos(np.clip(plane[0][2], -1, 1))))
        rotation, turned = lean @ rotation, turned.rotated(lean)
    facts["rotation"] = rotation
    return turned, facts
