"""Read our GLB and OBJ files with trimesh and compare surface, uvs and texture."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

trimesh = pytest.importorskip("trimesh")

ROOT = Path(__file__).resolve().parents[2]
BUILD = Path(os.environ.get("TT3D_BUILD", ROOT / "build/release"))
# The test sphere has its centre at (1, 2, 3) and a radius of 0.9 to 1.1.
CENTRE = np.array([1, 2, 3])


@pytest.fixture(scope="module")
def assets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    program = BUILD / "tests/asset/asset_test"
    if not program.exists():
        pytest.skip(f"{program} is not built")
    folder = tmp_path_factory.mktemp("assets")
    subprocess.run(
        [program, "--gtest_filter=Glb.WrittenForOtherTools"],
        env={**os.environ, "TT3D_ASSET_OUT": str(folder)},
        check=True,
        capture_output=True,
    )
    return folder


def load(path: Path) -> trimesh.Trimesh:
    return trimesh.load(path, force="mesh", process=False)


def check_texture(mesh: trimesh.Trimesh, up_axis: int) -> None:
    material = mesh.visual.material
    image = getattr(material, "baseColorTexture", None) or material.image
    assert image.size == (24, 16)
    assert mesh.visual.uv.shape == (len(mesh.vertices), 2)
    # In trimesh v starts at the bottom; the texture's top is the north pole.
    assert np.corrcoef(mesh.visual.uv[:, 1], mesh.vertices[:, up_axis])[0, 1] > 0.95


def test_obj_has_the_coordinates_of_the_input(assets: Path) -> None:
    mesh = load(assets / "object.obj")
    assert np.abs(mesh.bounds.mean(axis=0) - CENTRE).max() < 0.15
    assert len(mesh.faces) == 2 * 8 * 12
    assert mesh.volume > 0
    check_texture(mesh, up_axis=2)


def test_glb_is_y_up(assets: Path) -> None:
    mesh = load(assets / "object.glb")
    x, y, z = CENTRE
    assert np.abs(mesh.bounds.mean(axis=0) - [x, z, -y]).max() < 0.15
    assert len(mesh.faces) == 2 * 8 * 12
    assert mesh.volume > 0
    check_texture(mesh, up_axis=1)


def test_glb_and_obj_are_the_same_surface(assets: Path) -> None:
    y_up = load(assets / "object.glb").triangles
    z_up = load(assets / "object.obj").triangles
    turned = np.stack([y_up[..., 0], -y_up[..., 2], y_up[..., 1]], axis=-1)
    assert turned == pytest.approx(z_up, abs=1e-6)


def test_a_million_faces_and_four_million_pixels_in_little_memory(tmp_path: Path) -> None:
    program = BUILD / "tt3d"
    if not program.exists():
        pytest.skip(f"{program} is not built")
    ball = trimesh.creation.icosphere(subdivisions=8)
    assert len(ball.faces) > 1_000_000
    longitude = np.arctan2(ball.vertices[:, 1], ball.vertices[:, 0])
    uv = np.stack([longitude / (2 * np.pi) + 0.5, 0.5 + ball.vertices[:, 2] / 2], 1)
    texture = Image.fromarray(np.full((64, 64, 3), (10, 200, 30), np.uint8))
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=texture)
    ball.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    ball.export(tmp_path / "ball.glb")
    out = tmp_path / "views"
    command = [program, "render", tmp_path / "ball.glb", "--out", out, "--views", "1"]
    # The peak of this child only, not of all earlier children.
    measured = subprocess.run(
        [sys.executable, "-c",
         "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True);"
         "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)",
         *command, "--size", "2048", "-q"],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    assert int(measured.stdout.splitlines()[-1]) < 4 << 20  # KiB
    picture = np.asarray(Image.open(next(out.rglob("*.png"))).convert("RGBA"))
    assert picture.shape == (2048, 2048, 4)
    shown = picture[picture[..., 3] == 255][:, :3]
    assert len(shown) > 2048 * 2048 / 10
    assert np.abs(shown.astype(int) - (10, 200, 30)).max() <= 1
