"""Measure the distance between two surfaces, and find self-intersections.

    python geometry.py CLEAN.safetensors ADVERSARIAL.safetensors OUT.json

Distances are in the input's units and measured in both directions. They start from points drawn
uniformly by area (fixed seed) and from all vertices, and end at the nearest point of the other
surface among its nearby triangles.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

sys.path.insert(0, str(Path(__file__).resolve().parent))
import toolkit

if TYPE_CHECKING:
    import numpy as np
    import trimesh

SAMPLES = 30_000
CANDIDATES = 8  # triangles that are compared exactly with a query point


def surface_points(mesh: trimesh.Trimesh, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return random points by area and all face corners, and the face of each point."""
    import numpy as np

    random = np.random.default_rng(0)
    share = mesh.area_faces / mesh.area_faces.sum()
    face = random.choice(len(mesh.faces), count, p=share)
    a, b = np.sqrt(random.random(count))[:, None], random.random(count)[:, None]
    t = mesh.triangles[face]
    drawn = (1 - a) * t[:, 0] + a * (1 - b) * t[:, 1] + a * b * t[:, 2]
    corners = mesh.triangles.reshape(-1, 3)
    return np.concatenate([drawn, corners]), np.concatenate(
        [face, np.repeat(np.arange(len(mesh.faces)), 3)]
    )


def one_way(
    points: np.ndarray, owner: np.ndarray, source: trimesh.Trimesh, target: trimesh.Trimesh
) -> tuple[np.ndarray, np.ndarray]:
    """Return the distances of `points` on `source` to `target`, and the angles of normals, deg."""
    import numpy as np
    from scipy.spatial import cKDTree
    from trimesh.triangles import closest_point

    samples, faces = surface_points(target, SAMPLES)
    _, near = cKDTree(samples).query(points, k=CANDIDATES)
    best, where = np.full(len(points), np.inf), np.zeros(len(points), int)
    for k in range(CANDIDATES):
        face = faces[near[:, k]]
        distance = np.linalg.norm(closest_point(target.triangles[face], points) - points, axis=1)
        better = distance < best
        best[better], where[better] = distance[better], face[better]
    cosine = (source.face_normals[owner] * target.face_normals[where]).sum(axis=1)
    return best, np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def distances(a: trimesh.Trimesh, b: trimesh.Trimesh) -> dict[str, float]:
    """Return Chamfer (mean over both directions), Hausdorff (largest) and normal deviation."""
    there = one_way(*surface_points(a, SAMPLES), a, b)
    back = one_way(*surface_points(b, SAMPLES), b, a)
    drawn = slice(0, SAMPLES)  # by area; the corners count only for the largest distance
    return {
        "chamfer": float(there[0][drawn].mean() + back[0][drawn].mean()) / 2,
        "hausdorff": float(max(there[0].max(), back[0].max())),
        "normal_deviation_deg": float(there[1][drawn].mean() + back[1][drawn].mean()) / 2,
    }


def self_intersections(mesh: trimesh.Trimesh) -> np.ndarray:
    """Return the indices of faces crossed by an edge with which they share no vertex."""
    import numpy as np
    from trimesh.ray.ray_pyembree import RayMeshIntersector

    edges, faces_of = mesh.edges, mesh.edges_face
    unique = np.unique(np.sort(edges, axis=1), axis=0, return_index=True)[1]
    edges, owners = edges[unique], faces_of[unique]
    begin, span = mesh.vertices[edges[:, 0]], np.diff(mesh.vertices[edges], axis=1)[:, 0]
    length = np.linalg.norm(span, axis=1)
    alive = length > 0
    edges, owners, begin, span, length = (x[alive] for x in (edges, owners, begin, span, length))
    tracer = RayMeshIntersector(mesh)
    place, ray, face = tracer.intersects_location(begin, span / length[:, None])
    along = np.linalg.norm(place - begin[ray], axis=1)
    inside = (along > 1e-5 * length[ray]) & (along < (1 - 1e-5) * length[ray])
    shared = (mesh.faces[face][:, :, None] == edges[ray][:, None, :]).any(axis=(1, 2))
    hit = inside & ~shared
    return np.unique(np.concatenate([face[hit], owners[ray[hit]]]))


def work(arguments: list[str]) -> None:
    """Compare two meshes."""
    for package in ("numpy", "scipy", "trimesh", "embreex"):
        toolkit.need_package(package, "geometry measures")
    import mesh_data

    clean, adversarial = (mesh_data.read_mesh(p).triangles() for p in arguments[:2])
    result = distances(clean, adversarial)
    for name, mesh in (("clean", clean), ("adversarial", adversarial)):
        result[f"self_intersecting_faces_{name}"] = len(self_intersections(mesh))
    Path(arguments[2]).write_text(json.dumps(result))


if __name__ == "__main__":
    toolkit.main(work)
