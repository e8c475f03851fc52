"""Make the UV atlas of a triangle mesh with xatlas. tt3d runs this file as a child process.

    python unwrap.py INPUT.safetensors OUTPUT.safetensors RESOLUTION PADDING

Input tensors: vertices [V,3] float32, faces [F,3] int32. Output tensors: uvs [T,2] float32 in
[0,1], uv_faces [F,3] int32 into uvs. Exit status 3 means that a package is not installed.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

sys.path.insert(0, str(Path(__file__).resolve().parent))
import toolkit

if TYPE_CHECKING:
    import numpy as np

# Share of the atlas that charts cover, measured with xatlas on meshes of 5,000 to 60,000 faces.
# The atlas is scaled to the requested resolution, so a wrong value only changes the padding.
EXPECTED_FILL = 0.68


def surface_area(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Return the sum of the triangles' areas."""
    import numpy as np

    a, b, c = (vertices[faces[:, k]].astype(np.float64) for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def unwrap(
    vertices: np.ndarray, faces: np.ndarray, resolution: int, padding: int
) -> tuple[np.ndarray, np.ndarray]:
    """Cut the surface into charts and pack them into one square atlas.

    Return uvs [T,2] in [0,1] and uv_faces [F,3].
    """
    import numpy as np
    import xatlas

    # Scaling to unit area makes xatlas's epsilons independent of the input's scale.
    area = surface_area(vertices, faces)
    centred = vertices - vertices.mean(axis=0, dtype=np.float64)
    unit = (centred / np.sqrt(area)).astype(np.float32)
    atlas = xatlas.Atlas()
    atlas.add_mesh(unit, np.ascontiguousarray(faces, dtype=np.uint32))
    options = xatlas.PackOptions()
    options.padding = padding
    options.texels_per_unit = resolution * float(np.sqrt(EXPECTED_FILL))
    atlas.generate(xatlas.ChartOptions(), options)
    _, uv_faces, uvs = atlas[0]
    side = max(atlas.width, atlas.height)
    scale = np.array([atlas.width / side, atlas.height / side], dtype=np.float32)
    return np.clip(uvs * scale, 0, 1), uv_faces.astype(np.int32)


def work(arguments: list[str]) -> None:
    """Unwrap the mesh named on the command line."""
    source, target, resolution, padding = arguments
    toolkit.need_package("xatlas", "UV unwrapping")
    safetensors = toolkit.need_package("safetensors.numpy", "UV unwrapping", "safetensors")
    mesh = safetensors.load_file(source)
    uvs, uv_faces = unwrap(mesh["vertices"], mesh["faces"], int(resolution), int(padding))
    safetensors.save_file({"uvs": uvs, "uv_faces": uv_faces}, target)


if __name__ == "__main__":
    toolkit.main(work)
