"""Our GLB and OBJ files read by trimesh: the same surface, uvs and texture as were written."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

trimesh = pytest.importorskip("trimesh")

ROOT = Path(__file__).resolve().parents[2]
BUILD = Path(os.environ.get("TT3D_BUILD", ROOT / "build/release"))
# The test sphere has its centre at (1, 2, 3) and a radius of 0.9 to 1.1.
CENTRE = np.array([1, 2, 3])


@pytest.fixture(scope="module")
def assets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    program = BUILD / "tests/bake/bake_test"
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
    # trimesh counts v from the bottom; the texture's top is the north pole.
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
