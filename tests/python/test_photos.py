"""`tt3d photos`: cameras, up direction, masks and figures against the truth; bad input."""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

np = pytest.importorskip("numpy")
cv2 = pytest.importorskip("cv2", reason="opencv is not installed (scripts/setup --all)")
pytest.importorskip("scipy", reason="scipy is not installed (scripts/setup --all)")
sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "python"))
import photo_scene  # noqa: E402
from PIL import Image  # noqa: E402
from tool_support import PROGRAM, tt3d  # noqa: E402
from tt3d_tools import toolkit  # noqa: E402
from tt3d_tools.photos import cameras, frames, gains, sparse, upright  # noqa: E402

needs_program = pytest.mark.skipif(not PROGRAM.exists(), reason=f"{PROGRAM} is not built")
needs_colmap = pytest.mark.skipif(
    shutil.which("colmap") is None, reason="colmap is not installed (scripts/setup --all)"
)
needs_ffmpeg = pytest.mark.skipif(
    shutil.which("ffmpeg") is None, reason="ffmpeg is not installed (scripts/setup --all)"
)


@pytest.fixture(scope="module")
def scene() -> list[photo_scene.SceneView]:
    return photo_scene.ring(20, gains=0.15)


@pytest.fixture(scope="module")
def folder(scene: list, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the scene's photographs."""
    path = tmp_path_factory.mktemp("photographs")
    for i, view in enumerate(scene):
        Image.fromarray(view.pixels).save(path / f"{i:02d}.png")
    return path


@pytest.fixture(scope="module")
def capture(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the capture that tt3d photos makes of the scene."""
    if shutil.which("colmap") is None or not PROGRAM.exists():
        pytest.skip("needs the program and colmap (scripts/setup --all)")
    path = tmp_path_factory.mktemp("capture") / "scene"
    done = tt3d("photos", folder, "--out", path)
    assert done.returncode == 0, done.stderr
    assert "page:" in done.stdout
    return path


def test_cameras_match_the_truth(capture: Path, scene: list) -> None:
    model = sparse.read_model(capture / "sparse/0")
    assert len(model.views) == len(scene)
    index = [int(Path(view.name).stem) for view in model.views]
    errors, common = photo_scene.rotation_errors(
        [view.rotation for view in model.views], [scene[i].rotation for i in index]
    )
    assert errors.max() < 1
    up_error = np.degrees(np.arccos(common[2, 2]))
    assert up_error < 2


def test_masks_match_the_truth(capture: Path, scene: list) -> None:
    overlaps = []
    for i, view in enumerate(scene):
        mask = cv2.imread(str(capture / f"masks/{i:02d}.png"), cv2.IMREAD_GRAYSCALE) > 127
        overlaps.append((mask & view.mask).sum() / (mask | view.mask).sum())
    assert np.mean(overlaps) >= 0.95, np.round(overlaps, 3)


def test_info_prints_the_figures(capture: Path) -> None:
    facts = json.loads(tt3d("info", capture, "--json").stdout)
    assert facts["hull_overlap"] > 0.85
    assert facts["largest_gap_deg"] < 60
    assert facts["up"] == [0, 0, 1]
    assert (capture / "capture.html").read_text().count("<figure") == 20


def test_a_second_run_keeps_everything_and_your_own_mask(capture: Path, tmp_path: Path) -> None:
    copy = tmp_path / "capture"
    shutil.copytree(capture, copy)
    source = json.loads((copy / "capture.json").read_text())["source"]
    before = (copy / "sparse/0/images.txt").stat().st_mtime_ns
    own = np.zeros((300, 400), np.uint8)
    own[100:200, 150:250] = 255
    cv2.imwrite(str(copy / "masks/03.png"), own)
    done = tt3d("photos", source, "--out", copy)
    assert done.returncode == 0, done.stderr
    assert (copy / "sparse/0/images.txt").stat().st_mtime_ns == before
    assert (cv2.imread(str(copy / "masks/03.png"), cv2.IMREAD_GRAYSCALE) == own).all()
    assert "03" in done.stdout  # the page advises against such a mask


@needs_program
def test_bad_masks_are_named(capture: Path, tmp_path: Path) -> None:
    copy = tmp_path / "capture"
    shutil.copytree(capture, copy)

    def mask(i: int) -> np.ndarray:
        return cv2.imread(str(capture / f"masks/{i:02d}.png"), cv2.IMREAD_GRAYSCALE)

    cv2.imwrite(str(copy / "masks/02.png"), 255 - mask(2))
    cv2.imwrite(str(copy / "masks/05.png"), np.roll(mask(5), 60, 1))
    cv2.imwrite(str(copy / "masks/09.png"), 0 * mask(9))
    advice = json.loads(tt3d("info", copy, "--json").stdout)["advice"]
    text = "\n".join(advice)
    assert "02.jpg: its mask is inverted" in text
    assert "05.jpg: its mask" in text
    assert "09.jpg: its mask is empty" in text
    assert "01.jpg: its mask" not in text


@needs_program
def test_plain_photographs_name_the_command(folder: Path, tmp_path: Path) -> None:
    done = tt3d("fit", folder, "--out", tmp_path / "run")
    assert done.returncode == 2
    assert "tt3d photos" in done.stderr
    assert not (tmp_path / "run").exists()


@needs_program
def test_five_photographs(folder: Path, tmp_path: Path) -> None:
    few = tmp_path / "few"
    few.mkdir()
    for path in sorted(folder.iterdir())[:5]:
        shutil.copy(path, few)
    done = tt3d("photos", few, "--out", tmp_path / "out")
    assert done.returncode == 2
    assert "has 5 photographs" in done.stderr and "at least 10" in done.stderr


@needs_program
def test_missing_colmap(folder: Path, tmp_path: Path) -> None:
    python = subprocess.run(
        [sys.executable, "-c", "import sys; print(sys.executable)"], capture_output=True, text=True
    ).stdout.strip()
    done = subprocess.run(
        [PROGRAM, "photos", folder, "--out", tmp_path / "out"],
        capture_output=True,
        text=True,
        env={**os.environ, "PATH": str(tmp_path), "TT3D_PYTHON": python},
    )
    assert done.returncode == 3
    assert "apt-get install colmap" in done.stderr


@needs_program
@needs_colmap
def test_blurred_photographs(scene: list, tmp_path: Path) -> None:
    folder = tmp_path / "blurred"
    folder.mkdir()
    for i, view in enumerate(scene):
        cv2.imwrite(str(folder / f"{i:02d}.png"), cv2.GaussianBlur(view.pixels, (0, 0), 12))
    done = tt3d("photos", folder, "--out", tmp_path / "out")
    assert done.returncode == 2
    assert "blurred" in done.stderr.splitlines()[-1]


@needs_program
@needs_colmap
def test_photographs_of_different_things(tmp_path: Path) -> None:
    folder = tmp_path / "different"
    folder.mkdir()
    random = np.random.default_rng(0)
    for i in range(12):
        small = random.integers(0, 256, (40, 50, 3), np.uint8)
        picture = cv2.resize(small, (400, 320), interpolation=cv2.INTER_NEAREST)
        cv2.imwrite(str(folder / f"{i:02d}.png"), picture)
    done = tt3d("photos", folder, "--out", tmp_path / "out")
    assert done.returncode == 2
    assert "only 0 of 12 photographs show the same thing" in done.stderr


def test_copies_are_left_out(scene: list, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    folder = tmp_path / "copies"
    folder.mkdir()
    for i, view in enumerate(scene[:10]):
        for copy in "ab":
            Image.fromarray(view.pixels).save(folder / f"{i:02d}{copy}.jpg", quality=90)
    found = frames.write_frames(folder, tmp_path / "images")
    assert len(found) == 10
    assert "10 of 20 photographs are copies" in capsys.readouterr().out


def test_orientation_is_applied_and_removed(scene: list, tmp_path: Path) -> None:
    folder = tmp_path / "turned"
    folder.mkdir()
    for i, view in enumerate(scene[:10]):
        exif = Image.Exif()
        exif[0x0112] = 6  # the camera was turned by 90 degrees
        Image.fromarray(np.rot90(view.pixels)).save(folder / f"{i}.png", exif=exif)
    found = frames.write_frames(folder, tmp_path / "images")
    assert (found[0].width, found[0].height) == (400, 300)
    with Image.open(tmp_path / "images" / found[0].name) as image:
        assert 0x0112 not in image.getexif()
        difference = np.abs(np.asarray(image, float) - scene[0].pixels).mean()
    assert difference < 5


@needs_ffmpeg
def test_video_without_motion(scene: list, tmp_path: Path) -> None:
    picture = tmp_path / "still.png"
    Image.fromarray(scene[0].pixels).save(picture)
    video = tmp_path / "still.mp4"
    command = ["ffmpeg", "-v", "error", "-loop", "1", "-i", str(picture), "-t", "3", str(video)]
    subprocess.run(command, check=True)
    with pytest.raises(toolkit.InputProblem, match="the camera does not move"):
        frames.write_frames(video, tmp_path / "images")


@needs_ffmpeg
def test_the_sharpest_frames_of_a_turned_video(scene: list, tmp_path: Path) -> None:
    for i, view in enumerate(scene):
        for k in range(4):
            blurred = view.pixels if k == 1 else cv2.GaussianBlur(view.pixels, (0, 0), 3)
            lying = np.rot90(blurred)
            Image.fromarray(np.ascontiguousarray(lying)).save(tmp_path / f"{4 * i + k:04d}.png")
    video = tmp_path / "video.mp4"
    command = ["ffmpeg", "-v", "error", "-framerate", "8", "-i", str(tmp_path / "%04d.png")]
    command += ["-pix_fmt", "yuv420p", "-crf", "12", "-metadata:s:v:0", "rotate=270", str(video)]
    subprocess.run(command, check=True)
    found = frames.write_frames(video, tmp_path / "images")
    assert 10 <= len(found) <= 45
    assert {(f.width, f.height) for f in found} in ({(400, 300)}, {(300, 400)})


def test_up_of_a_tilted_ring_is_found(scene: list) -> None:
    """Half a ring of tilted cameras: the mean up axis leans, the x axes do not."""
    lens = sparse.Lens("PINHOLE", 400, 300, [440, 440, 200, 150])
    tilt = upright.rotation_to_z(np.array([0.6, 0.48, 0.64]))
    views = [
        sparse.View(
            f"{i}", 1, v.rotation @ tilt.T, v.translation, np.zeros((0, 2)), np.zeros(0, int)
        )
        for i, v in enumerate(scene[: len(scene) // 2 - 3])
    ]
    model = sparse.Model({1: lens}, views, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    up = upright.camera_up(model)
    assert np.degrees(np.arccos(up @ tilt[:, 2])) < 2


def test_rotation_to_z() -> None:
    for up in ([0, 0, 1.0], [0, 0, -1.0], [0.6, 0.0, 0.8], [0, 1.0, 0]):
        rotation = upright.rotation_to_z(np.array(up))
        np.testing.assert_allclose(rotation @ up, [0, 0, 1], atol=1e-12)
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1)


def test_quaternions_round_trip() -> None:
    random = np.random.default_rng(0)
    for _ in range(50):
        q = random.normal(size=4)
        m = sparse.quaternion_matrix(q)
        np.testing.assert_allclose(
            sparse.quaternion_matrix(sparse.matrix_quaternion(m)), m, atol=1e-12
        )


def test_a_model_round_trips(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    lens = sparse.Lens("SIMPLE_RADIAL", 400, 300, [440.0, 200.0, 150.0, 0.02])
    rotation = sparse.quaternion_matrix(random.normal(size=4))
    points = random.normal(size=(5, 3))
    view = sparse.View(
        "a b.jpg", 1, rotation, random.normal(size=3), random.random((5, 2)) * 300, np.arange(5)
    )
    colours = random.integers(0, 256, (5, 3)).astype(np.uint8)
    model = sparse.Model({1: lens}, [view, view], points, colours, np.ones(5))
    sparse.write_text(model, tmp_path)
    back = sparse.read_model(tmp_path)
    np.testing.assert_allclose(back.points, points, atol=1e-7)
    np.testing.assert_allclose(back.views[0].rotation, rotation, atol=1e-9)
    assert back.views[0].name == "a b.jpg"
    assert (back.track_lengths == 2).all()


def test_gains_are_found(scene: list, tmp_path: Path) -> None:
    """Two photographs of the same points, one with known factors in linear light."""
    pixels = np.full((60, 80, 3), 120, np.uint8)
    pixels[:, 40:] = (90, 140, 60)
    factors = np.array([1.5, 1.0, 0.7])
    linear = gains.to_linear(pixels / 255.0)

    def srgb(light: np.ndarray) -> np.ndarray:
        return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)

    for name, gain in (("a.png", np.ones(3)), ("b.png", factors)):
        Image.fromarray(np.round(255 * srgb(linear * gain)).astype(np.uint8)).save(tmp_path / name)
    y, x = np.mgrid[8:52:8, 8:72:8]
    points = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    count = len(points)
    views = [
        sparse.View(name, 1, np.eye(3), np.zeros(3), points, np.arange(count))
        for name in ("a.png", "b.png")
    ]
    model = sparse.Model(
        {}, views, np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count), np.full(count, 2)
    )
    found = gains.find_gains(model, tmp_path, np.ones(count, bool))
    ratio = np.array(found["a.png"]) / np.array(found["b.png"])
    np.testing.assert_allclose(ratio, factors, rtol=0.03)


def test_matches_are_mutual_and_distinct() -> None:
    random = np.random.default_rng(0)
    descriptors = random.random((50, 128)).astype(np.float32) ** 8
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    order = random.permutation(50)
    pairs = cameras.match(descriptors, descriptors[order])
    assert len(pairs) == 50
    assert (order[pairs[:, 1]] == pairs[:, 0]).all()


@needs_colmap
def test_the_database_is_what_colmap_reads(tmp_path: Path) -> None:
    frame = frames.Frame("a.jpg", "a.jpg", 400, 300, 1, 100, 0)
    features = (np.ones((3, 4), np.float32), np.ones((3, 128), np.float32))
    cameras.create_database(
        tmp_path / "d.db", [frame, replace(frame, name="b.jpg")], [features, features]
    )
    with sqlite3.connect(tmp_path / "d.db") as database:
        assert database.execute("SELECT COUNT(*) FROM cameras").fetchone() == (1,)
        assert database.execute("SELECT rows, cols FROM keypoints").fetchall() == [(3, 4)] * 2
