"""Read our 3MF, STL and PLY with other programs; check meshes with known faults for printing."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

np = pytest.importorskip("numpy")
trimesh = pytest.importorskip("trimesh")
Image = pytest.importorskip("PIL.Image")
sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "python/tt3d_tools"))
from tool_support import PROGRAM, texture, tt3d, write_asset  # noqa: E402

pytestmark = pytest.mark.skipif(not PROGRAM.exists(), reason=f"{PROGRAM} is not built")
SIZE = 80.0


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("lib3mf")
    folder = tmp_path_factory.mktemp("export")
    obj = write_asset(folder)
    for kind in ("glb", "ply", "stl", "3mf"):
        out = folder / f"out.{kind}"
        done = tt3d("export", obj, "--out", out, "--size-mm", SIZE)
        assert done.returncode == 0, done.stderr
    return folder


def original(folder: Path) -> trimesh.Trimesh:
    mesh = trimesh.load(folder / "asset.obj", force="mesh", process=False, maintain_order=True)
    mesh.apply_scale(SIZE / mesh.extents.max())
    return mesh


def test_3mf_in_lib3mf(exported: Path) -> None:
    """Check the unit, the positions, and the texture coordinates of a triangle."""
    import lib3mf

    model = lib3mf.get_wrapper().CreateModel()
    model.QueryReader("3mf").ReadFromFile(str(exported / "out.3mf"))
    assert model.GetUnit() == lib3mf.ModelUnit.MilliMeter
    solids = model.GetMeshObjects()
    assert solids.MoveNext()
    solid = solids.GetCurrentMeshObject()
    assert solid.IsManifoldAndOriented()
    points = np.array([list(v.Coordinates) for v in solid.GetVertices()])
    assert np.abs(np.ptp(points, axis=0) - original(exported).extents).max() < 1e-3
    groups = model.GetTexture2DGroups()
    assert groups.MoveNext()
    group = groups.GetCurrentTexture2DGroup()
    picture = bytes(group.GetTexture2D().GetAttachment().WriteToBuffer())
    (exported / "out.png").write_bytes(picture)
    assert (np.asarray(Image.open(exported / "out.png").convert("RGB")) == texture()).all()
    mesh = trimesh.load(exported / "asset.obj", force="mesh", process=False)
    triangle = solid.GetTriangleProperties(17)
    coordinates = [group.GetTex2Coord(i) for i in triangle.PropertyIDs]
    corners = points[list(solid.GetTriangle(17).Indices)] / SIZE * mesh.extents.max()
    for found, corner in zip(coordinates, corners, strict=True):
        near = np.linalg.norm(mesh.vertices - corner, axis=1) < 1e-4
        assert np.abs(mesh.visual.uv[near] - [found.U, found.V]).sum(axis=1).min() < 1e-4


@pytest.mark.parametrize("kind", ["3mf", "stl", "ply"])
def test_bounds_and_volume_in_trimesh(exported: Path, kind: str) -> None:
    if kind == "3mf":
        pytest.importorskip("networkx")
        pytest.importorskip("lxml")
    mesh = trimesh.load(exported / f"out.{kind}", force="mesh")
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    expected = original(exported)
    assert np.abs(mesh.bounds - expected.bounds).max() < 1e-3
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(expected.volume, rel=1e-4)


def test_ply_has_the_colours_of_the_texture(exported: Path) -> None:
    mesh = trimesh.load(exported / "out.ply", process=False)
    flat = trimesh.load(exported / "asset.obj", force="mesh", process=False)
    scale = SIZE / flat.extents.max()
    found = mesh.visual.vertex_colors[:, :3].astype(float)
    checked = 0
    for vertex, uv in zip(flat.vertices[60:400:7], flat.visual.uv[60:400:7], strict=True):
        if not 0.05 < uv[0] < 0.95:
            continue  # a vertex on the seam has two texture coordinates
        near = int(np.linalg.norm(mesh.vertices - vertex * scale, axis=1).argmin())
        row, column = round((1 - uv[1]) * 256 - 0.5), round(uv[0] * 256 - 0.5)
        assert np.abs(found[near] - texture()[row, column]).max() <= 6
        checked += 1
    assert checked > 20


def test_blender_reads_the_same_bounds(exported: Path) -> None:
    blender = shutil.which("blender")
    if blender is None:
        pytest.skip("blender is not installed (scripts/setup --all)")
    script = (
        "import bpy\nimport numpy\n"
        "numpy.bool = getattr(numpy, 'bool', bool)\n"
        "for name in ('glb', 'stl', 'ply'):\n"
        "    bpy.ops.wm.read_factory_settings(use_empty=True)\n"
        f"    path = '{exported}/out.' + name\n"
        "    if name == 'glb': bpy.ops.import_scene.gltf(filepath=path)\n"
        "    if name == 'stl':\n"
        "        bpy.ops.preferences.addon_enable(module='io_mesh_stl')\n"
        "        bpy.ops.import_mesh.stl(filepath=path)\n"
        "    if name == 'ply':\n"
        "        bpy.ops.preferences.addon_enable(module='io_mesh_ply')\n"
        "        bpy.ops.import_mesh.ply(filepath=path)\n"
        "    bpy.context.view_layer.update()\n"
        "    o = [o for o in bpy.data.objects if o.type == 'MESH'][0]\n"
        "    corners = [o.matrix_world @ v.co for v in o.data.vertices]\n"
        "    low = [min(c[k] for c in corners) for k in range(3)]\n"
        "    high = [max(c[k] for c in corners) for k in range(3)]\n"
        "    print('BOUNDS', name, *low, *high)\n"
    )
    done = subprocess.run(
        [blender, "-b", "--factory-startup", "--python-expr", script],
        capture_output=True,
        text=True,
        timeout=300,
    )
    lines = [x.split() for x in done.stdout.splitlines() if x.startswith("BOUNDS")]
    assert [x[1] for x in lines] == ["glb", "stl", "ply"], done.stdout[-2000:]
    for words in lines:
        found = np.array(list(map(float, words[2:]))).reshape(2, 3)
        assert np.abs(found - original(exported).bounds).max() < 1e-2, words[1]


def check(*words: object) -> dict[str, dict]:
    done = tt3d("print-check", *words, "--json")
    assert done.returncode == 0, done.stderr
    return {f["check"]: f for f in json.loads(done.stdout)["findings"]}


def write_mesh(folder: Path, mesh: trimesh.Trimesh, name: str = "mesh") -> Path:
    """Write an OBJ without uvs, so with one colour."""
    path = folder / f"{name}.obj"
    lines = ["v {:.7g} {:.7g} {:.7g}".format(*v) for v in mesh.vertices]
    lines += ["f {} {} {}".format(*(f + 1)) for f in mesh.faces]
    path.write_text("\n".join(lines) + "\n")
    return path


needs_tools = pytest.mark.skipif(
    subprocess.run(
        [sys.executable, "-c", "import embreex, skimage"], capture_output=True
    ).returncode
    != 0,
    reason="embreex or scikit-image is not installed (scripts/setup --all)",
)


@needs_tools
def test_a_box_is_printable_and_its_walls_are_its_sides(tmp_path: Path) -> None:
    box = write_mesh(tmp_path, trimesh.creation.box((10, 6, 4)))
    found = check(box, "--size-mm", 100)
    assert all(f["ok"] for f in found.values()), found
    assert found["wall thickness"]["value"]["quantile_01_mm"] == pytest.approx(40, rel=1e-3)
    assert found["flat base"]["value"] == pytest.approx(100 * 60, rel=1e-3)
    thin = write_mesh(tmp_path, trimesh.creation.box((10, 6, 0.05)), "thin")
    walls = check(thin, "--size-mm", 100)["wall thickness"]
    assert not walls["ok"] and walls["value"]["share_below"] > 0.9


def write_broken_asset(folder: Path) -> Path:
    """The textured asset with a hole, twenty reversed faces, and a small separate component."""
    path = write_asset(folder)
    lines = path.read_text().splitlines()
    faces = [line.split()[1:] for line in lines if line.startswith("f ")]
    lines = [line for line in lines if not line.startswith("f ")]
    del faces[700]
    faces[40:60] = [face[::-1] for face in faces[40:60]]
    first = 1 + sum(line.startswith("v ") for line in lines)
    crumb = trimesh.creation.box((0.01, 0.01, 0.01)).apply_translation((2, 0, 0.5))
    lines += ["v {:.7g} {:.7g} {:.7g}".format(*v) for v in crumb.vertices]
    faces += [[f"{v + first}/1" for v in face] for face in crumb.faces]
    lines += ["f " + " ".join(face) for face in faces]
    path.write_text("\n".join(lines) + "\n")
    return path


@needs_tools
def test_faults_are_found_and_repaired_and_the_texture_survives(tmp_path: Path) -> None:
    path = write_broken_asset(tmp_path)
    before = check(path)
    assert not before["watertight"]["ok"] and before["watertight"]["advice"]
    assert not before["oriented"]["ok"]
    assert before["loose parts"]["value"] == 2
    out, size, base = tmp_path / "repaired.glb", 100, 2
    after = check(path, "--repair", out, "--size-mm", size, "--flat-base", base)
    for name in ("watertight", "oriented", "loose parts", "flat base"):
        assert after[name]["ok"], after[name]
    repaired = trimesh.load(out, force="mesh", process=False)
    picture = np.asarray(repaired.visual.material.baseColorTexture.convert("RGB"))
    assert (picture == texture()).all()
    # Every corner has a texture coordinate that the unbroken asset has at the same position.
    whole = trimesh.load(write_asset(tmp_path), force="mesh", process=False)
    corners = whole.vertices * size / whole.extents.max()
    corners[:, 2] = np.maximum(corners[:, 2], corners[:, 2].min() + base)
    x, y, z = repaired.vertices.T  # glTF is Y-up
    for place, uv in zip(np.stack([x, -z, y], 1), repaired.visual.uv, strict=True):
        near = np.linalg.norm(corners - place, axis=1) < 1e-3
        assert near.any()
        assert np.abs(whole.visual.uv[near] - uv).sum(axis=1).min() < 1e-4


@needs_tools
def test_overhang_of_a_mushroom_and_crossing_spheres(tmp_path: Path) -> None:
    stem = trimesh.creation.cylinder(1, 6)
    cap = trimesh.creation.cylinder(6, 1)
    cap.apply_translation([0, 0, 3.2])
    both = write_mesh(tmp_path, trimesh.util.concatenate([stem, cap]))
    found = check(both)
    assert not found["overhang"]["ok"] and found["overhang"]["value"] > 0.2
    assert not found["self-intersections"]["ok"]


@needs_tools
def test_gamut(tmp_path: Path) -> None:
    obj = write_asset(tmp_path)
    cube = [f"#{r}{g}{b}" for r in ("00", "ff") for g in ("00", "ff") for b in ("00", "ff")]
    (tmp_path / "all.txt").write_text("\n".join(cube) + "\n")
    greys = ["#404040", "#505050", "#4a4a52", "#524a4a", "#4a524a"]
    (tmp_path / "greys.txt").write_text("\n".join(greys) + "\n")
    assert check(obj, "--gamut", tmp_path / "all.txt")["gamut"]["value"] < 0.02
    assert check(obj, "--gamut", tmp_path / "greys.txt")["gamut"]["value"] > 0.9
    (tmp_path / "bad.txt").write_text("#00ff00\nred\n")
    done = tt3d("print-check", obj, "--gamut", tmp_path / "bad.txt")
    assert done.returncode == 2 and "bad.txt:2" in done.stderr


def test_bad_input(tmp_path: Path) -> None:
    obj = write_asset(tmp_path)
    assert tt3d("export", obj, "--out", tmp_path / "x.fbx").returncode == 2
    assert tt3d("export", tmp_path / "absent.obj", "--out", tmp_path / "x.stl").returncode == 2
    empty = tmp_path / "empty.obj"
    empty.write_text("v 0 0 0\n")
    assert tt3d("print-check", empty).returncode == 2
    (tmp_path / "asset.png").unlink()
    done = tt3d("export", obj, "--out", tmp_path / "x.stl")
    assert done.returncode == 2 and "asset.png" in done.stderr


def test_the_sheet_has_a_bar_of_ten_centimetres(tmp_path: Path) -> None:
    out = tmp_path / "sheet.svg"
    done = tt3d("print-sheet", "--out", out, "--object", "hen & <egg>", "--size-mm", 120)
    assert done.returncode == 0, done.stderr
    import xml.etree.ElementTree as Tree

    root = Tree.parse(out).getroot()
    assert root.get("width") == "210mm" and root.get("viewBox") == "0 0 210 297"
    bars = [r for r in root.iter("{http://www.w3.org/2000/svg}rect") if r.get("width") == "10"]
    places = [float(r.get("x")) for r in bars]
    assert max(places) + 10 - min(places) == 100
