"""Write a mesh as 3MF, STL or PLY, scaled to a size in millimetres on request.

    python export_mesh.py MESH.safetensors OUT SIZE_MM

SIZE_MM is the longest side of the bounding box; 0 keeps the mesh's own units. 3MF has millimetres
and the texture. STL has only the geometry. PLY has vertex colours, looked up in the texture.
"""

from __future__ import annotations

import io
import sys
from pathlib import Path
from typing import TYPE_CHECKING

sys.path.insert(0, str(Path(__file__).resolve().parent))
import toolkit

if TYPE_CHECKING:
    from mesh_data import Mesh


def scale_to(mesh: Mesh, size_mm: float) -> None:
    """Scale the mesh about the origin to `size_mm` along the longest side of its box."""
    import numpy as np

    longest = float((mesh.vertices.max(0) - mesh.vertices.min(0)).max())
    if size_mm > 0:
        mesh.vertices = (mesh.vertices.astype(np.float64) * (size_mm / longest)).astype(np.float32)


def write_3mf(mesh: Mesh, path: Path) -> None:
    """Write a textured 3MF with lib3mf. In 3MF, v starts at the bottom."""
    lib3mf = toolkit.need_package("lib3mf", "3MF")
    from PIL import Image

    wrapper = lib3mf.get_wrapper()
    model = wrapper.CreateModel()
    model.SetUnit(lib3mf.ModelUnit.MilliMeter)
    solid = model.AddMeshObject()
    solid.SetName(path.stem)
    positions = [
        lib3mf.Position((lib3mf.ctypes.c_float * 3)(*map(float, p))) for p in mesh.vertices
    ]
    triangles = [lib3mf.Triangle((lib3mf.ctypes.c_uint32 * 3)(*map(int, f))) for f in mesh.faces]
    solid.SetGeometry(positions, triangles)
    picture = io.BytesIO()
    Image.fromarray(mesh.texture).save(picture, "PNG")
    attachment = model.AddAttachment(
        "/3D/Textures/texture.png", "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dtexture"
    )
    attachment.ReadFromBuffer(list(picture.getvalue()))
    texture = model.AddTexture2DFromAttachment(attachment)
    texture.SetContentType(lib3mf.TextureType.PNG)
    clamp = lib3mf.TextureTileStyle.Clamp
    texture.SetTileStyleUV(clamp, clamp)
    group = model.AddTexture2DGroup(texture)
    coordinates = [
        group.AddTex2Coord(lib3mf.Tex2Coord(float(u), float(1 - v))) for u, v in mesh.uvs
    ]
    resource = group.GetResourceID()
    properties = []
    for corners in mesh.uv_faces:
        ids = [coordinates[int(c)] for c in corners]
        properties.append(lib3mf.TriangleProperties(resource, (lib3mf.ctypes.c_uint32 * 3)(*ids)))
    solid.SetAllTriangleProperties(properties)
    first = properties[0]
    solid.SetObjectLevelProperty(resource, first.PropertyIDs[0])
    model.AddBuildItem(solid, wrapper.GetIdentityTransform())
    model.QueryWriter("3mf").WriteToFile(str(path))


def write_stl(mesh: Mesh, path: Path) -> None:
    """Write a binary STL."""
    mesh.triangles().export(path, file_type="stl")


def write_ply(mesh: Mesh, path: Path) -> None:
    """Write a binary PLY with vertex colours."""
    import trimesh

    colors = mesh.vertex_colors()
    trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=colors, process=False).export(
        path, file_type="ply", vertex_normal=False
    )


WRITERS = {".3mf": write_3mf, ".stl": write_stl, ".ply": write_ply}


def work(arguments: list[str]) -> None:
    """Write the file in the format of its extension."""
    source, out, size_mm = arguments
    path = Path(out)
    for package in ("numpy", "trimesh", "PIL"):
        toolkit.need_package(package, path.suffix, "pillow" if package == "PIL" else None)
    from mesh_data import read_mesh

    mesh = read_mesh(source)
    scale_to(mesh, float(size_mm))
    temporary = path.with_name(f".{path.name}.part{path.suffix}")
    WRITERS[path.suffix.lower()](mesh, temporary)
    temporary.replace(path)


if __name__ == "__main__":
    toolkit.main(work)
