"""Check a mesh for 3D printing, give advice, and repair simple faults.

    python print_check.py JOB.json

The job has the `mesh`, `size_mm` (longest side), `wall_mm`, `overhang_deg`, the `gamut` file (a
colour `#rrggbb` a line) or "", `flat_base_mm`, `repair` (a file for the repaired mesh, or "") and
`out`. The repair functions are our own where trimesh's would lose the texture coordinates.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parent))
import toolkit

if TYPE_CHECKING:
    import numpy as np
    import trimesh
    from mesh_data import Mesh

SMALL_PART = 0.001  # share of the area below which a loose part is dropped
LONGEST_HOLE = 200  # edges of a hole that is closed by a fan
THICKNESS_RAYS = 20_000
GAMUT_TOLERANCE = 3.0  # CIE 1976 colour difference


def finding(name: str, good: bool, value: Any, text: str, advice: str) -> dict[str, Any]:
    """Return the result of one check; it has advice only if the check failed."""
    return {
        "check": name,
        "ok": bool(good),
        "value": value,
        "text": text,
        "advice": "" if good else advice,
    }


def parts_of(mesh: trimesh.Trimesh) -> np.ndarray:
    """Return the index of the connected part of each face; parts share no vertex."""
    import numpy as np
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    f = mesh.faces
    edges = np.concatenate([f[:, [0, 1]], f[:, [1, 2]]])
    n = len(mesh.vertices)
    graph = coo_matrix((np.ones(len(edges)), edges.T), (n, n))
    _, label = connected_components(graph, directed=False)
    return np.unique(label[f[:, 0]], return_inverse=True)[1]


def wall_thickness(mesh: trimesh.Trimesh) -> np.ndarray:
    """Return the lengths of inward rays from surface points (by area, fixed seed)."""
    import numpy as np
    from geometry import surface_points
    from trimesh.ray.ray_pyembree import RayMeshIntersector

    points, face = surface_points(mesh, THICKNESS_RAYS)
    points, face = points[:THICKNESS_RAYS], face[:THICKNESS_RAYS]
    inwards = -mesh.face_normals[face]
    step = 1e-5 * mesh.scale
    places, ray, _ = RayMeshIntersector(mesh).intersects_location(
        points + step * inwards, inwards, multiple_hits=False
    )
    return np.linalg.norm(places - points[ray], axis=1)


def lab(srgb: np.ndarray) -> np.ndarray:
    """Convert sRGB in [0,1] to CIE L*a*b* (D65)."""
    from skimage.color import rgb2lab

    return rgb2lab(srgb.reshape(1, -1, 3)).reshape(-1, 3)


def out_of_gamut(colors: np.ndarray, palette: np.ndarray) -> np.ndarray:
    """Return the indices of colours outside the palette's convex hull in L*a*b*, with tolerance."""
    import numpy as np
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(lab(palette))
    except (QhullError, ValueError) as error:
        raise toolkit.InputProblem(
            "gamut: needs at least four colours that are not in one plane"
        ) from error
    outside = (lab(colors) @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
    return np.flatnonzero(outside > GAMUT_TOLERANCE)


def read_palette(path: str) -> np.ndarray:
    """Read a file with a colour #rrggbb a line; return [N,3] in [0,1]."""
    import numpy as np

    colors = []
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise toolkit.InputProblem(f"{path}: cannot be read: {error}") from error
    for number, line in enumerate(text.splitlines(), 1):
        word = line.split(" ")[0].strip()
        if not word:
            continue
        try:
            if len(word) != 7 or word[0] != "#":
                raise ValueError
            colors.append([int(word[k : k + 2], 16) / 255 for k in (1, 3, 5)])
        except ValueError as error:
            raise toolkit.InputProblem(
                f"{path}:{number}: expected #rrggbb, got '{word}'"
            ) from error
    return np.array(colors)


def topology_findings(mesh: trimesh.Trimesh) -> list[dict[str, Any]]:
    """Check holes, orientation, self-intersections and loose parts."""
    import numpy as np
    from geometry import self_intersections

    _, uses = np.unique(np.sort(mesh.edges, axis=1), axis=0, return_counts=True)
    open_edges, crowded = int((uses == 1).sum()), int((uses > 2).sum())
    label = parts_of(mesh)
    area = np.bincount(label, mesh.area_faces)
    crossing = len(self_intersections(mesh))
    oriented = mesh.is_winding_consistent and (not mesh.is_watertight or mesh.volume > 0)
    return [
        finding(
            "watertight",
            open_edges == 0 and crowded == 0,
            {"open_edges": open_edges, "crowded_edges": crowded},
            f"{open_edges} open edges, {crowded} edges with more than two faces",
            "--repair closes small holes; repair larger ones in a mesh editor before slicing",
        ),
        finding(
            "oriented",
            oriented,
            bool(oriented),
            "normals point outwards" if oriented else "normals disagree or point inwards",
            "--repair orients the faces",
        ),
        finding(
            "self-intersections",
            crossing == 0,
            crossing,
            f"{crossing} of {len(mesh.faces)} faces cross another face",
            "most slicers unite overlaps; to have fewer, raise attack.laplacian_weight or lower "
            "attack.max_displacement",
        ),
        finding(
            "loose parts",
            len(area) == 1,
            len(area),
            f"{len(area)} parts; the largest has {area.max() / area.sum():.1%} of the area",
            "--repair removes parts under 0.1 % of the area; join or remove larger ones",
        ),
    ]


def shape_findings(mesh: trimesh.Trimesh, job: dict[str, Any]) -> list[dict[str, Any]]:
    """Check walls, overhangs and the base at the size of the print."""
    import numpy as np

    findings, height = [], mesh.vertices[:, 2].max() - mesh.vertices[:, 2].min()
    walls = wall_thickness(mesh)
    if len(walls):
        thin, low = float((walls < job["wall_mm"]).mean()), float(np.quantile(walls, 0.01))
        findings.append(
            finding(
                "wall thickness",
                thin < 0.01,
                {"share_below": thin, "quantile_01_mm": low},
                f"{thin:.1%} of the surface is thinner than {job['wall_mm']:g} mm; its thinnest "
                f"hundredth is below {low:.2f} mm",
                f"print it {job['wall_mm'] / max(low, 1e-6):.1f} times larger, or thicken walls",
            )
        )
    down = mesh.face_normals[:, 2] < -np.cos(np.radians(job["overhang_deg"]))
    floor = mesh.vertices[:, 2].min() + 0.01 * height
    resting = mesh.vertices[mesh.faces][:, :, 2].max(axis=1) <= floor
    overhang = float(mesh.area_faces[down & ~resting].sum() / mesh.area)
    base = float(mesh.area_faces[down & resting].sum())
    shadow = np.ptp(mesh.vertices[:, 0]) * np.ptp(mesh.vertices[:, 1])
    findings.append(
        finding(
            "overhang",
            overhang < 0.05,
            overhang,
            f"{overhang:.1%} of the area leans more than {job['overhang_deg']:g} degrees outwards",
            "print with supports, or turn the object",
        )
    )
    findings.append(
        finding(
            "flat base",
            base > 0.02 * shadow,
            base,
            f"{base:.1f} mm2 rest on the plate",
            "--flat-base MM with --repair flattens the lowest part; or print with a raft",
        )
    )
    return findings


def gamut_finding(mesh: Mesh, palette: np.ndarray) -> dict[str, Any]:
    """Check for surface colours outside the printer's palette."""
    import numpy as np
    from geometry import surface_points

    triangles = mesh.triangles()
    points, face = surface_points(triangles, 20_000)
    from trimesh.triangles import points_to_barycentric

    weights = points_to_barycentric(triangles.triangles[face], points)
    good = np.isfinite(weights).all(axis=1)
    uvs = np.einsum("nk,nkc->nc", weights[good], mesh.uvs[mesh.uv_faces[face[good]]])
    colors = mesh.colors_at(uvs)
    outside = out_of_gamut(colors, palette)
    share = len(outside) / max(1, len(colors))
    return finding(
        "gamut",
        share < 0.02,
        share,
        f"{share:.1%} of the surface has colours that the printer cannot mix",
        "raise attack.printability_weight, or expect duller colours and measure the print",
    )


def repair(mesh: Mesh, flat_base_mm: float, size_mm: float) -> tuple[Mesh, list[str]]:
    """Remove broken faces and tiny parts, orient faces, close holes, flatten the base."""
    import numpy as np

    done = []
    area = mesh.triangles().area_faces
    bad = (area <= 0) | (np.diff(np.sort(mesh.faces, axis=1), axis=1) == 0).any(axis=1)
    _, first = np.unique(np.sort(mesh.faces, axis=1), axis=0, return_index=True)
    keep = ~bad & np.isin(np.arange(len(bad)), first)
    if not keep.all():
        done.append(f"removed {int((~keep).sum())} degenerate or duplicate faces")
        mesh = mesh.select(keep)
    label = parts_of(mesh.triangles())
    size = np.bincount(label, mesh.triangles().area_faces)
    small = size < SMALL_PART * size.sum()
    if small.any():
        done.append(f"removed {int(small.sum())} loose parts")
        mesh = mesh.select(~small[label])
    turned = orient_faces(mesh)
    if turned:
        done.append(f"reversed {turned} faces")
    closed = close_holes(mesh)
    if closed:
        done.append(f"closed {closed} holes")
    if flat_base_mm > 0:
        low = mesh.vertices.min(0)  # without the parts that were removed
        longest = float((mesh.vertices.max(0) - low).max())
        level = float(low[2]) + flat_base_mm * longest / size_mm
        below = mesh.vertices[:, 2] < level
        mesh.vertices = mesh.vertices.copy()
        mesh.vertices[below, 2] = level
        done.append(f"flattened {int(below.sum())} vertices")
    return mesh, done


def orient_faces(mesh: Mesh) -> int:
    """Orient faces consistently and closed parts outwards, with their uvs; return the number."""
    import numpy as np
    import trimesh

    before = mesh.faces.copy()
    triangles = mesh.triangles()
    trimesh.repair.fix_normals(triangles, multibody=True)
    after = np.asarray(triangles.faces)
    parity = lambda a, b: np.array(  # noqa: E731
        [any((np.roll(x, k) == y).all() for k in range(3)) for x, y in zip(a, b, strict=True)]
    )
    changed = np.flatnonzero((before != after).any(axis=1))
    turned = changed[~parity(before[changed], after[changed])] if len(changed) else changed
    mesh.faces = before
    mesh.uv_faces = mesh.uv_faces.copy()
    mesh.faces[turned] = mesh.faces[turned][:, ::-1]
    mesh.uv_faces[turned] = mesh.uv_faces[turned][:, ::-1]
    return len(turned)


def close_holes(mesh: Mesh) -> int:
    """Close loops of open edges by fans in the colours of the rim; return the number of loops."""
    import numpy as np

    halves = {}
    for f, t in zip(mesh.faces.tolist(), mesh.uv_faces.tolist(), strict=True):
        for k in range(3):
            halves[f[k], f[(k + 1) % 3]] = (t[k], t[(k + 1) % 3])
    rim = {b: (a, uv) for (a, b), uv in halves.items() if (b, a) not in halves}
    faces, uv_faces, loops = [], [], 0
    while rim:
        start = next(iter(rim))
        loop, places, at = [], [], start
        while at in rim:
            before, uv = rim.pop(at)
            loop.append(at)
            places.append(uv[1])
            at = before
        if at != start or len(loop) < 3 or len(loop) > LONGEST_HOLE:
            continue
        loops += 1
        for k in range(1, len(loop) - 1):
            faces.append([loop[0], loop[k], loop[k + 1]])
            uv_faces.append([places[0], places[k], places[k + 1]])
    if faces:
        mesh.faces = np.concatenate([mesh.faces, np.array(faces, np.int32)])
        mesh.uv_faces = np.concatenate([mesh.uv_faces, np.array(uv_faces, np.int32)])
    return loops


def work(arguments: list[str]) -> None:
    """Check a mesh, after repairing it if the job asks for it."""
    (path,) = arguments
    job = toolkit.read_job(path)
    for package in ("numpy", "scipy", "trimesh", "embreex", "skimage"):
        name = "scikit-image" if package == "skimage" else None
        toolkit.need_package(package, "print-check", name)
    from export_mesh import scale_to
    from mesh_data import read_mesh, write_mesh

    mesh = read_mesh(job["mesh"])
    palette = read_palette(job["gamut"]) if job["gamut"] else None
    repaired: list[str] = []
    if job["repair"]:
        mesh, repaired = repair(mesh, job["flat_base_mm"], job["size_mm"])
        write_mesh(mesh, job["repair"])
    scale_to(mesh, job["size_mm"])
    triangles = mesh.triangles()
    findings = topology_findings(triangles) + shape_findings(triangles, job)
    if palette is not None:
        findings.append(gamut_finding(mesh, palette))
    Path(job["out"]).write_text(json.dumps({"repaired": repaired, "findings": findings}))


if __name__ == "__main__":
    toolkit.main(work)
