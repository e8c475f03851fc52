"""Files as people have them reach the commands: photographs on their side, names in upper case."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tool_support import TOY, tt3d, write_asset

ORIENTATION = 0x0112
# What the camera did to the upright picture, for each value of the EXIF orientation.
STORED = {
    1: lambda a: a,
    2: lambda a: a[:, ::-1],
    3: lambda a: a[::-1, ::-1],
    4: lambda a: a[::-1],
    5: lambda a: a.swapaxes(0, 1),
    6: lambda a: np.rot90(a, 1),
    7: lambda a: a[::-1, ::-1].swapaxes(0, 1),
    8: lambda a: np.rot90(a, -1),
}


def photograph() -> np.ndarray:
    """Return a picture without symmetry, [48,80,3]."""
    y, x = np.mgrid[0:48, 0:80]
    return np.stack([x * 3, y * 5, np.where(x > 2 * y, 220, 20)], axis=2).astype(np.uint8)


def save_turned(path: Path, orientation: int, quality: int = 95) -> None:
    """Save the photograph as a camera in that orientation does."""
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    pixels = np.ascontiguousarray(STORED[orientation](photograph()))
    Image.fromarray(pixels).save(path, exif=exif, quality=quality, subsampling=0)


def probabilities(*paths: Path) -> list[list[float]]:
    """Return the probabilities of the first five classes of each picture, by class."""
    done = tt3d("model", "classify", TOY, *paths, "--top", 5, "--json")
    assert done.returncode == 0, done.stderr
    found = []
    for image in json.loads(done.stdout)["images"]:
        found.append([t["probability"] for t in sorted(image["top"], key=lambda t: t["index"])])
    return found


@pytest.mark.parametrize(("extension", "tolerance"), [(".png", 0), (".jpg", 2e-3)])
def test_classify_shows_the_upright_picture(
    tmp_path: Path, extension: str, tolerance: float
) -> None:
    paths = [tmp_path / f"{orientation}{extension}" for orientation in STORED]
    for orientation, path in zip(STORED, paths, strict=True):
        save_turned(path, orientation)
    found = np.array(probabilities(*paths))
    assert np.abs(found - found[0]).max() <= tolerance


def test_hidden_files_of_a_folder_are_skipped(tmp_path: Path) -> None:
    save_turned(tmp_path / "a.JPG", 1)
    (tmp_path / "._a.JPG").write_bytes(b"Mac OS X")
    (tmp_path / ".DS_Store").write_bytes(b"Mac")
    assert len(probabilities(tmp_path)) == 1


def test_upper_case_extensions_of_backgrounds_and_assets(tmp_path: Path) -> None:
    asset = write_asset(tmp_path)
    asset = asset.rename(asset.with_suffix(".OBJ"))
    photos = tmp_path / "photos"
    photos.mkdir()
    for name in ("IMG_0001.JPG", "IMG_0002.JPEG"):
        save_turned(photos / name, 1)
    assert tt3d("info", asset).returncode == 0
    made = tmp_path / "b.GLB"
    done = tt3d("export", asset, "--out", made)
    assert done.returncode == 0, done.stderr
    assert made.read_bytes()[:4] == b"glTF"
    target = json.loads(tt3d("model", "classify", TOY, photos, "--json").stdout)
    label = target["images"][0]["top"][0]["name"]
    done = tt3d(
        "evaluate", made, "--target", label, "--victims", TOY, "--views", 2, "--size", 32,
        "--background", photos, "--out", tmp_path / "e.json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def test_info_describes_a_capture_by_its_camera_file(tmp_path: Path) -> None:
    frames = []
    for i in range(6):
        angle = np.pi * i / 3
        out = np.array([np.cos(angle), np.sin(angle), 0])
        pose = np.eye(4)
        pose[:3] = np.stack([[-out[1], out[0], 0], [0, 0, 1], out, 3 * out], axis=1)
        rgba = np.zeros((40, 40, 4), dtype=np.uint8)
        rgba[15:25, 15:25] = 255
        Image.fromarray(rgba).save(tmp_path / f"{i}.png")
        frames.append({"file_path": f"{i}.png", "transform_matrix": pose.tolist()})
    root = {"camera_angle_x": 0.8, "frames": frames}
    (tmp_path / "transforms.json").write_text(json.dumps(root))
    (tmp_path / "few.json").write_text(json.dumps({**root, "frames": frames[:4]}))
    for name, views in (("", 6), ("transforms.json", 6), ("few.json", 4)):
        done = tt3d("info", tmp_path / name, "--json")
        assert done.returncode == 0, done.stderr
        facts = json.loads(done.stdout)
        assert facts["kind"] == "capture"
        assert facts["train_views"] + facts["test_views"] == views
    (tmp_path / "bad.json").write_text("{}")
    done = tt3d("info", tmp_path / "bad.json")
    assert done.returncode == 2
    assert "bad.json: expected an object with an array 'frames'" in done.stderr
