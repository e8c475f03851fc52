"""UV atlas of a triangle mesh with xatlas, run by tt3d as a child process.

    python unwrap.py INPUT.safetensors OUTPUT.safetensors RESOLUTION PADDING

Input tensors: vertices [V,3] float32, faces [F,3] int32. Output tensors: uvs [T,2] float32 in
[0,1], uv_faces [F,3] int32 into uvs. Exit status 3 means that xatlas is not installed.
"""

from __future__ import annotations

import json
import struct
import sys
from pathlib import Path
from typing import TYPE_CHECKING

sys.path.insert(0, str(Path(__file__).resolve().parent))
import toolkit

if TYPE_CHECKING:
    import numpy as np

# Share of the atlas that charts cover, from xatlas runs on meshes of 5,000 to 60,000 faces; the
# size that comes out is scaled to the resolution asked for, so a wrong guess only costs padding.
EXPECTED_FILL = 0.68
DTYPES = {"F32": "<f4", "I32": "<i4", "U8": "u1"}


def read_tensors(path: Path) -> dict[str, np.ndarray]:
    """Reads float32 and int32 tensors from a safetensors file."""
    import numpy as np

    content = path.read_bytes()
    (header_size,) = struct.unpack_from("<Q", content)
    header = json.loads(content[8 : 8 + header_size])
    tensors = {}
    for name, entry in header.items():
        if name == "__metadata__":
            continue
        begin, end = (8 + header_size + offset for offset in entry["data_offsets"])
        data = np.frombuffer(content[begin:end], dtype=DTYPES[entry["dtype"]])
        tensors[name] = data.reshape(entry["shape"])
    return tensors


def write_tensors(path: Path, tensors: dict[str, np.ndarray]) -> None:
    """Writes float32 and int32 tensors to a safetensors file."""
    import numpy as np

    header, blocks, offset = {}, [], 0
    for name, tensor in tensors.items():
        dtype = "F32" if tensor.dtype.kind == "f" else "I32"
        block = np.ascontiguousarray(tensor, dtype=DTYPES[dtype]).tobytes()
        end = offset + len(block)
        header[name] = {"dtype": dtype, "shape": tensor.shape, "data_offsets": [offset, end]}
        blocks.append(block)
        offset = end
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    path.write_bytes(struct.pack("<Q", len(text)) + text + b"".join(blocks))


def surface_area(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Sum of the triangles' areas."""
    import numpy as np

    a, b, c = (vertices[faces[:, k]].astype(np.float64) for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def unwrap(
    vertices: np.ndarray, faces: np.ndarray, resolution: int, padding: int
) -> tuple[np.ndarray, np.ndarray]:
    """Cuts the surface into charts and packs them into one square atlas.

    Returns uvs [T,2] in [0,1] and uv_faces [F,3].
    """
    import numpy as np
    import xatlas

    # Unit area keeps xatlas's epsilons away from the scale of the input.
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
    """Runs the conversion named on the command line."""
    source, target, resolution, padding = arguments
    toolkit.need_package("xatlas", "UV unwrapping")
    tensors = read_tensors(Path(source))
    uvs, uv_faces = unwrap(tensors["vertices"], tensors["faces"], int(resolution), int(padding))
    write_tensors(Path(target), {"uvs": uvs, "uv_faces": uv_faces})


if __name__ == "__main__":
    toolkit.main(work)
