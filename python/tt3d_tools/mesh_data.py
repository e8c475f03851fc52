"""Textured meshes as tt3d hands them to its tools: safetensors with what its own loader read."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

sys.path.insert(0, str(Path(__file__).resolve().parent))
from unwrap import read_tensors, write_tensors

if TYPE_CHECKING:
    import numpy as np
    import trimesh


@dataclass
class Mesh:
    """World coordinates, +Z up; uvs with (0,0) at the top left corner of the texture."""

    vertices: np.ndarray  # [V,3] float32
    faces: np.ndarray  # [F,3] int32
    uvs: np.ndarray  # [T,2] float32
    uv_faces: np.ndarray  # [F,3] int32
    texture: np.ndarray  # [H,W,3] uint8, sRGB

    def select(self, keep: np.ndarray) -> Mesh:
        """The mesh with a part of its faces; vertices that none uses any more are dropped."""
        import numpy as np

        used, inverse = np.unique(self.faces[keep], return_inverse=True)
        faces = inverse.reshape(-1, 3).astype(np.int32)
        return Mesh(self.vertices[used], faces, self.uvs, self.uv_faces[keep], self.texture)

    def triangles(self) -> trimesh.Trimesh:
        """The geometry for trimesh, untouched."""
        import trimesh

        return trimesh.Trimesh(self.vertices, self.faces, process=False)

    def colors_at(self, uvs: np.ndarray) -> np.ndarray:
        """Bilinear look-up: [N,2] to [N,3] float in [0,1]."""
        import numpy as np

        height, width = self.texture.shape[:2]
        x = np.clip(uvs[:, 0] * width - 0.5, 0, width - 1)
        y = np.clip(uvs[:, 1] * height - 0.5, 0, height - 1)
        left, top = np.floor(x).astype(int), np.floor(y).astype(int)
        right, low = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
        u, v = (x - left)[:, None], (y - top)[:, None]
        texels = self.texture.astype(np.float64) / 255
        upper = texels[top, left] * (1 - u) + texels[top, right] * u
        lower = texels[low, left] * (1 - u) + texels[low, right] * u
        return upper * (1 - v) + lower * v

    def vertex_colors(self) -> np.ndarray:
        """[V,3] uint8: the mean over the places that a vertex has in the texture."""
        import numpy as np

        sums, counts = np.zeros((len(self.vertices), 3)), np.zeros(len(self.vertices))
        corners = self.faces.reshape(-1)
        np.add.at(sums, corners, self.colors_at(self.uvs[self.uv_faces.reshape(-1)]))
        np.add.at(counts, corners, 1)
        return np.round(255 * sums / np.maximum(counts, 1)[:, None]).astype(np.uint8)


def read_mesh(path: str | Path) -> Mesh:
    """What tt3d wrote with save_tensors."""
    tensors = read_tensors(Path(path))
    return Mesh(*(tensors[k] for k in ("vertices", "faces", "uvs", "uv_faces", "texture")))


def write_mesh(mesh: Mesh, path: str | Path) -> None:
    """Geometry for tt3d to write with the texture it has already."""
    write_tensors(
        Path(path),
        {
            "vertices": mesh.vertices,
            "faces": mesh.faces,
            "uvs": mesh.uvs,
            "uv_faces": mesh.uv_faces,
        },
    )
