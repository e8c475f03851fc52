"""Render the same asset from the same cameras in four renderers."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

np = pytest.importorskip("numpy")
Image = pytest.importorskip("PIL.Image")
sys.path.insert(0, str(Path(__file__).resolve().parent))
from tool_support import PROGRAM, ROOT, TOY, tt3d, write_asset  # noqa: E402

NEEDS = {
    "mitsuba": [],
    "blender": ["blender"],
    "meshlab": ["meshlab", "Xvfb", "xdotool", "xclip"],
}
VIEWS = 3


def skip_without(renderer: str) -> None:
    if not PROGRAM.exists():
        pytest.skip(f"{PROGRAM} is not built")
    for tool in NEEDS[renderer]:
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed (scripts/setup --all)")
    if renderer == "mitsuba":
        pytest.importorskip("mitsuba")


@pytest.fixture(scope="module")
def assets(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return the asset as OBJ, and as a GLB that tt3d wrote."""
    if not PROGRAM.exists():
        pytest.skip(f"{PROGRAM} is not built")
    folder = tmp_path_factory.mktemp("asset")
    obj = write_asset(folder)
    done = tt3d("export", obj, "--out", folder / "asset.glb")
    assert done.returncode == 0, done.stderr
    return {"obj": obj, "glb": folder / "asset.glb"}


def pictures(asset: Path, folder: Path, *options: str) -> np.ndarray:
    """Read pictures as [N,H,W,4] in [0,1], straight alpha."""
    done = tt3d("render", asset, "--views", VIEWS, "--size", 160, "--out", folder, *options)
    assert done.returncode == 0, done.stderr
    files = [folder / f"test/r_{i}.png" for i in range(VIEWS)]
    return np.stack([np.asarray(Image.open(f).convert("RGBA"), float) / 255 for f in files])


def psnr_on_object(a: np.ndarray, b: np.ndarray) -> float:
    both = (a[..., 3] > 0.999) & (b[..., 3] > 0.999)
    return float(-10 * np.log10(((a - b)[both][:, :3] ** 2).mean()))


@pytest.mark.parametrize("renderer", NEEDS)
@pytest.mark.parametrize("kind", ["glb", "obj"])
def test_unlit_pictures_agree_with_ours(
    assets: dict[str, Path], tmp_path: Path, renderer: str, kind: str
) -> None:
    """Wrong axes, a flipped texture or a wrong colour space would each cost more than 10 dB."""
    skip_without(renderer)
    if (renderer, kind) == ("meshlab", "obj"):
        pytest.skip("MeshLab is given the same file for both")
    ours = pictures(assets[kind], tmp_path / "ours")
    theirs = pictures(assets[kind], tmp_path / "theirs", "--renderer", renderer)
    assert psnr_on_object(ours, theirs) > 30
    inside = np.minimum(ours[..., 3], theirs[..., 3]).sum()
    assert inside / np.maximum(ours[..., 3], theirs[..., 3]).sum() > 0.97
    # The measure is sensitive: mirrored pictures are far apart.
    assert psnr_on_object(ours, theirs[:, :, ::-1]) < 25


@pytest.mark.parametrize("renderer", ["mitsuba", "blender", "meshlab"])
def test_a_high_contrast_texture_agrees_with_averaged_pixels(tmp_path: Path, renderer: str) -> None:
    """An adversarial texture has contrasts of a few texels, finer than a pixel at flat angles."""
    skip_without(renderer)
    asset = write_asset(tmp_path)
    random = np.random.default_rng(1)
    coarse = random.integers(0, 256, (40, 80, 3)).astype(np.uint8)
    Image.fromarray(coarse).resize((768, 384), Image.Resampling.BICUBIC).save(
        tmp_path / "asset.png"
    )
    theirs = pictures(asset, tmp_path / "theirs", "--renderer", renderer)
    one = pictures(asset, tmp_path / "one")
    four = pictures(asset, tmp_path / "four", "--samples", "4")
    assert psnr_on_object(one, theirs) < 28
    assert psnr_on_object(four, theirs) > 30


@pytest.mark.parametrize("renderer", ["mitsuba", "blender"])
def test_lit_pictures_have_ground_and_shadow(
    assets: dict[str, Path], tmp_path: Path, renderer: str
) -> None:
    skip_without(renderer)
    unlit = pictures(assets["glb"], tmp_path / "unlit")
    lit = pictures(assets["glb"], tmp_path / "lit", "--renderer", renderer, "--lit")
    frames = json.loads((tmp_path / "lit/transforms_train.json").read_text())["frames"]
    above = [i for i, f in enumerate(frames) if f["elevation_deg"] > 15]
    assert above, "the seed gives a view from above"
    for i in above:
        ground = (lit[i, ..., 3] > 0.99) & (unlit[i, ..., 3] < 0.01)
        assert ground.mean() > 0.2
        levels = lit[i][ground][:, 0]
        # sRGB of 0.6 times (0.5 + 0.46) in the sun, 0.6 times less than 0.5 in the shadow.
        assert np.quantile(levels, 0.95) == pytest.approx(0.78, abs=0.04)
        assert levels.min() < 0.62
    body = unlit[..., 3] > 0.99
    assert np.abs(lit - unlit)[body].mean() > 0.02


def test_meshlab_has_the_ground_where_the_camera_is_above_it(
    assets: dict[str, Path], tmp_path: Path
) -> None:
    """MeshLab's lamp casts no shadow, so its ground is one grey. It is not drawn from below."""
    skip_without("meshlab")
    unlit = pictures(assets["glb"], tmp_path / "unlit")
    lit = pictures(assets["glb"], tmp_path / "lit", "--renderer", "meshlab", "--lit")
    frames = json.loads((tmp_path / "lit/transforms_train.json").read_text())["frames"]
    heights = [f["elevation_deg"] for f in frames]
    assert max(heights) > 15, "the seed gives a view from above"
    for picture, outline, height in zip(lit, unlit, heights, strict=True):
        ground = (picture[..., 3] > 0.99) & (outline[..., 3] < 0.01)
        if height > 15:
            assert ground.mean() > 0.2
            levels = picture[ground][:, :3]
            # Pixels on the object's edge contain some of the object.
            assert np.quantile(np.ptp(levels, axis=1), 0.98) < 0.01
            assert np.ptp(np.quantile(levels, [0.05, 0.95])) < 0.03
        elif height < -15:
            assert ground.mean() < 0.01


def test_evaluate_records_the_renderer(assets: dict[str, Path], tmp_path: Path) -> None:
    skip_without("mitsuba")
    out = tmp_path / "record.json"
    done = tt3d(
        "evaluate", assets["glb"], "--clean", assets["obj"], "--target", 0, "--victims", TOY,
        "--views", 2, "--size", 64, "--renderer", "mitsuba", "--lit", "--out", out,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    record = json.loads(out.read_text())
    assert record["renderer"]["name"] == "mitsuba" and record["renderer"]["lit"] is True
    assert record["renderer"]["version"].startswith("3.")
    assert record["naturalness"]["psnr"] > 30


def test_light_needs_another_renderer(assets: dict[str, Path], tmp_path: Path) -> None:
    done = tt3d("render", assets["glb"], "--views", 1, "--lit", "--out", tmp_path / "x")
    assert done.returncode == 2 and "mitsuba" in done.stderr
    done = tt3d("render", assets["glb"], "--views", 1, "--samples", 8, "--out", tmp_path / "x")
    assert done.returncode == 2 and "square" in done.stderr
    done = tt3d("render", assets["glb"], "--views", 1, "--renderer", "pov", "--out", tmp_path / "x")
    assert done.returncode == 2 and "blender" in done.stderr


@pytest.mark.parametrize("renderer", ["blender", "meshlab"])
def test_a_missing_tool_is_named(assets: dict[str, Path], tmp_path: Path, renderer: str) -> None:
    """With an empty PATH no program is found."""
    done = subprocess.run(
        [PROGRAM, "render", assets["glb"], "--views", "1", "--renderer", renderer,
         "--out", tmp_path / "x"],
        capture_output=True, text=True, cwd=ROOT,
        env={**os.environ, "PATH": str(tmp_path), "TT3D_PYTHON": sys.executable},
    )  # fmt: skip
    assert done.returncode == 3
    assert f"apt-get install {renderer}" in done.stderr


def test_a_hang_is_an_error(assets: dict[str, Path], tmp_path: Path) -> None:
    """Run with a fake MeshLab that never opens a window."""
    for tool in NEEDS["meshlab"][1:]:
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed (scripts/setup --all)")
    fake = tmp_path / "meshlab"
    fake.write_text("#!/bin/sh\nexec sleep 600\n")
    fake.chmod(0o755)
    done = subprocess.run(
        [PROGRAM, "render", assets["glb"], "--views", "1", "--renderer", "meshlab",
         "--out", tmp_path / "x"],
        capture_output=True, text=True, cwd=ROOT, timeout=300,
        env={**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "TT3D_MESHLAB_START": "5"},
    )  # fmt: skip
    assert done.returncode == 5
    assert "hangs" in done.stderr
