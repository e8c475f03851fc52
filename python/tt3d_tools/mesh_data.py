"""Textured meshes that tt3d passes to its tools, as safetensors files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    import trimesh


@dataclass
class Mesh:
    """A textured mesh in world coordinates, +Z up; uv (0,0) is the texture's top left corner."""

    vertices: np.ndarray  # [V,3] float32
    faces: np.ndarray  # [F,3] int32
    uvs: np.ndarray  # [T,2] float32
    uv_faces: np.ndarray  # [F,3] int32
    texture: np.ndarray  # [H,W,3] uint8, sRGB

    def select(self, keep: np.ndarray) -> Mesh:
        """Return the mesh with only the faces in `keep`, without unused vertices."""
        import numpy as np

        used, inverse = np.unique(self.faces[keep], return_inverse=True)
        faces = inverse.reshape(-1, 3).astype(np.int32)
        return Mesh(self.vertices[used], faces, self.uvs, self.uv_faces[keep], self.texture)

    def triangles(self) -> trimesh.Trimesh:
        """Return the geometry as a trimesh, without any processing."""
        import trimesh

        return trimesh.Trimesh(self.vertices, self.faces, process=False)

    def colors_at(self, uvs: np.ndarray) -> np.ndarray:
        """Look the texture up bilinearly: uvs [N,2] to colours [N,3], float in [0,1].

        The function of trimesh places texel centres elsewhere and rounds to 8 bits.
        """
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
        """Return [V,3] uint8, the mean colour over the texture coordinates of each vertex."""
        import numpy as np

        sums, counts = np.zeros((len(self.vertices), 3)), np.zeros(len(self.vertices))
        corners = self.faces.reshape(-1)
        np.add.at(sums, corners, self.colors_at(self.uvs[self.uv_faces.reshape(-1)]))
        np.add.at(counts, corners, 1)
        return np.round(255 * sums / np.maximum(counts, 1)[:, None]).astype(np.uint8)


def read_mesh(path: str | Path) -> Mesh:
    """Read a mesh file of tt3d."""
    from safetensors.numpy import load_file

    tensors = load_file(path)
    return Mesh(*(tensors[k] for k in ("vertices", "faces", "uvs", "uv_faces", "texture")))


def write_mesh(mesh: Mesh, path: str | Path) -> None:
    """Write the geometry for tt3d, which has the texture already."""
    import numpy as np
    from safetensors.numpy import save_file

    tensors = {
        "vertices": mesh.vertices.astype(np.float32),
        "faces": mesh.faces.astype(np.int32),
        "uvs": mesh.uvs.astype(np.float32),
        "uv_faces": mesh.uv_faces.astype(np.int32),
    }
    # save_file needs contiguous arrays.
    save_file({name: np.ascontiguousarray(tensor) for name, tensor in tensors.items()}, path)
