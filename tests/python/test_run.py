"""Test the program: a small run, killed and resumed, and wrong input."""

import csv
import hashlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = ROOT / "build/release/tt3d"
CAPTURE = ROOT / "examples/captures/chicken"
MODEL = ROOT / "tests/model/fixtures/toy_cnn.pt2"

pytestmark = pytest.mark.skipif(not PROGRAM.exists(), reason="build/release/tt3d is not built")

SMALL = f"""
seed = 3
[capture]
path = "{CAPTURE}"
max_size = 64
max_train_views = 24
max_test_views = 2
[field]
steps = 200
samples_per_step = 8192
ray_steps = 192
occupancy = 64
checkpoint_every = 30
[field.geometry]
finest = 128
log2_size = 13
[field.appearance]
finest = 128
log2_size = 13
[mesh]
resolution = 64
target_faces = 3000
min_faces = 500
max_faces = 6000
refine_steps = 40
checkpoint_every = 5
[attack]
target = "teapot"
surrogates = ["{MODEL}"]
steps = 15
views_per_step = 2
image_size = 48
psnr_floor = 0.0
checkpoint_every = 4
[bake]
resolution = 256
[evaluate]
true_class = "cup"
victims = ["{MODEL}"]
views = 8
size = 48
"""

RESULTS = [
    "field/field.safetensors",
    "field/metrics.json",
    "mesh/mesh.safetensors",
    "mesh/mesh.ply",
    "attack/attack.safetensors",
    "attack/curves.csv",
    "asset/adversarial.glb",
    "asset/clean.glb",
    "asset/adversarial.obj",
    "asset/adversarial.mtl",
    "asset/adversarial.png",
    "eval/builtin.csv",
]


def tt3d(*arguments: str | Path, timeout: float = 170) -> subprocess.CompletedProcess[str]:
    """Run the program with two threads."""
    environment = os.environ | {"OMP_NUM_THREADS": "2", "OMP_WAIT_POLICY": "PASSIVE"}
    return subprocess.run(
        [PROGRAM, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=timeout,
        env=environment,
        check=False,
    )


def hashes(run: Path) -> dict[str, str]:
    """Return the SHA-256 of every result that must be the same after an interruption."""
    return {name: hashlib.sha256((run / name).read_bytes()).hexdigest() for name in RESULTS}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a finished small run."""
    folder = tmp_path_factory.mktemp("run")
    (folder / "small.toml").write_text(SMALL)
    done = tt3d("run", folder / "small.toml", "--out", folder / "out")
    assert done.returncode == 0, done.stderr
    assert "report.html" in done.stdout
    return folder


def test_run_writes_all_documented_files(finished: Path) -> None:
    run = finished / "out"
    for name in [*RESULTS, "asset/clean.obj", "eval/builtin.json", "report.html", "run.json"]:
        assert (run / name).stat().st_size > 0, name
    record = json.loads((run / "run.json").read_text())
    names = [stage["name"] for stage in record["stages"]]
    assert names == ["field", "mesh", "attack", "bake", "evaluate", "report"]
    assert all(stage["seconds"] >= 0 and stage["peak_rss_bytes"] > 0 for stage in record["stages"])
    mesh = json.loads((run / "mesh/metrics.json").read_text())
    assert mesh["closed"] is True
    asset = json.loads((run / "asset/metrics.json").read_text())
    assert mesh["psnr_test"] > 15 and asset["psnr_test"] > 15
    assert not list(run.rglob("*checkpoint*")) and not list(run.rglob("*.tmp*"))


def test_report_includes_new_records_in_eval(finished: Path, tmp_path: Path) -> None:
    run = tmp_path / "copy"
    shutil.copytree(finished / "out", run)
    assert "Other renderers" not in (run / "report.html").read_text()
    record = json.loads((run / "eval/builtin.json").read_text())
    record["renderer"] = {"name": "mitsuba", "version": "3.9.1", "lit": True}
    (run / "eval/mitsuba-lit.json").write_text(json.dumps(record))
    (run / "eval/judge.json").write_text(json.dumps(JUDGE))
    (run / "eval/notes.json").write_text("not JSON")
    done = tt3d("report", run)
    assert done.returncode == 0, done.stderr
    page = (run / "report.html").read_text()
    assert "Other renderers" in page and "mitsuba, lit" in page and "captions" in page


JUDGE = {
    "task": "caption",
    "model": "m",
    "shares": {"teapot": 0.25},
    "asset": "a.glb",
    "renderer": {"name": "builtin", "lit": False},
    "background": "white",
    "views": {"distribution": "dome", "count": 20, "seed": 0},
}


def add_video(run: Path) -> dict:
    """Write the files of `video-score --out RUN/eval/take.json` with one frame."""
    image = pytest.importorskip("PIL.Image")
    answer = {"victim": "toy", "answer": "teapot", "probability": 0.5, "is_target": True}
    frame = {"picture": "00000.jpg", "seconds": 1.5, "background": "grass", "answers": [answer]}
    victim = {"name": "toy", "sha256": "0", "asr": 1.0, "frames": 1, "asr_ci95": [0.2, 1.0],
              "mean_target_probability": 0.5, "backgrounds": {}}  # fmt: skip
    record = {"video": "take.mp4", "video_sha256": "0", "width": 40, "height": 40,
              "duration_seconds": 2.0, "target": {"index": 3, "name": "teapot"}, "frames": 1,
              "victims": [victim], "strip": [frame], "tt3d_version": "0.1.0"}  # fmt: skip
    (run / "eval/take.json").write_text(json.dumps(record))
    (run / "eval/take.frames").mkdir()
    image.new("RGB", (40, 40), "green").save(run / "eval/take.frames/00000.jpg")
    return record


def test_report_shows_a_videos_frames(finished: Path, tmp_path: Path) -> None:
    run = tmp_path / "copy"
    shutil.copytree(finished / "out", run)
    record = add_video(run)
    assert tt3d("report", run).returncode == 0
    page = (run / "report.html").read_text()
    assert 'aria-label="Frames of take.mp4"' in page and 'alt="frame at 1.5' in page
    # A name outside the folder is not shown.
    record["strip"][0]["picture"] = "../../../secret.jpg"
    (run / "eval/take.json").write_text(json.dumps(record))
    one_line(tt3d("report", run), 2, "secret.jpg")
    frame = record["strip"][0]
    record["strip"] = [{**frame, "picture": 3}]
    (run / "eval/take.json").write_text(json.dumps(record))
    one_line(tt3d("report", run), 2, "take.json", "strip[0].picture")
    # Without the pictures, the shares remain.
    record["strip"] = [frame]
    (run / "eval/take.json").write_text(json.dumps(record))
    shutil.rmtree(run / "eval/take.frames")
    assert tt3d("report", run).returncode == 0
    page = (run / "report.html").read_text()
    assert "Frames of" not in page and "Video take.mp4" in page


def test_geometry_and_samples_of_the_own_evaluation(finished: Path, tmp_path: Path) -> None:
    pytest.importorskip("trimesh")
    pytest.importorskip("embreex")
    run = tmp_path / "copy"
    shutil.copytree(finished / "out", run)
    before = json.loads((run / "eval/builtin.json").read_text())
    assert before["geometry"] is None and before["renderer"]["samples"] == 1
    done = tt3d("bake", run, "--set", "evaluate.geometry=1", "--set", "evaluate.samples=4")
    assert done.returncode == 0, done.stderr
    done = tt3d("report", run)
    assert done.returncode == 0, done.stderr
    after = json.loads((run / "eval/builtin.json").read_text())
    assert after["renderer"]["samples"] == 4
    assert after["geometry"]["hausdorff"] >= after["geometry"]["chamfer"] > 0
    assert "Chamfer distance" in (run / "report.html").read_text()


def test_runs_compared_with_their_judges_and_videos(finished: Path, tmp_path: Path) -> None:
    run = tmp_path / "copy"
    shutil.copytree(finished / "out", run)
    add_video(run)
    (run / "eval/judge.json").write_text(json.dumps(JUDGE))
    done = tt3d("report", finished / "out", run, "--out", tmp_path / "page")
    assert done.returncode == 0, done.stderr
    rows = json.loads((tmp_path / "page/comparison.json").read_text())
    assert {row["run"] for row in rows["victims"]} == {"out", "copy"}
    assert [row["share"] for row in rows["tasks"]] == [0.25]
    assert [row["video"] for row in rows["videos"]] == ["take.mp4"]
    for table, key in (("", "victims"), ("-tasks", "tasks"), ("-videos", "videos")):
        with (tmp_path / f"page/comparison{table}.csv").open() as lines:
            assert len(list(csv.DictReader(lines))) == len(rows[key])
        assert "tabular" in (tmp_path / f"page/comparison{table}.tex").read_text()
    page = (tmp_path / "page/comparison.html").read_text()
    assert "take.mp4" in page and "captions" in page


@pytest.mark.parametrize(
    ("file", "content", "named"),
    [
        ("eval/builtin.json", "{", "builtin.json"),
        ("eval/builtin.json", '{"target": 3}', "builtin.json"),
        ("eval/builtin.csv", "head\nx,y\n", "builtin.csv:2"),
        ("mesh/metrics.json", "xx", "metrics"),
        ("asset/clean.glb", "glTF", "clean.glb"),
    ],
)
def test_report_of_a_damaged_run(
    finished: Path, tmp_path: Path, file: str, content: str, named: str
) -> None:
    run = tmp_path / "copy"
    shutil.copytree(finished / "out", run)
    (run / file).write_text(content)
    one_line(tt3d("report", run), 2, named)


def test_a_second_call_finds_the_run_finished(finished: Path) -> None:
    products = ["field/field.safetensors", "mesh/mesh.safetensors", "attack/attack.safetensors"]
    before = hashes(finished / "out")
    written = [(finished / "out" / name).stat().st_mtime_ns for name in products]
    again = tt3d("run", finished / "small.toml", "--out", finished / "out")
    assert again.returncode == 0
    assert hashes(finished / "out") == before
    assert [(finished / "out" / name).stat().st_mtime_ns for name in products] == written


def test_a_missing_product_is_made_again(finished: Path, tmp_path: Path) -> None:
    run = tmp_path / "out"
    shutil.copytree(finished / "out", run)
    before = hashes(run)
    (run / "asset/adversarial.glb").unlink()
    (run / "report.html").unlink()
    again = tt3d("run", finished / "small.toml", "--out", run)
    assert again.returncode == 0, again.stderr
    assert hashes(run) == before
    assert (run / "report.html").is_file()
    names = [stage["name"] for stage in json.loads((run / "run.json").read_text())["stages"]]
    assert names == ["field", "mesh", "attack", "bake", "evaluate", "report"]


def test_a_run_killed_at_random_times_gives_the_same_bytes(finished: Path, tmp_path: Path) -> None:
    randomness = random.Random(4)
    environment = os.environ | {"OMP_NUM_THREADS": "2", "OMP_WAIT_POLICY": "PASSIVE"}
    for attempt in range(6):
        process = subprocess.Popen(
            [PROGRAM, "run", finished / "small.toml", "--out", tmp_path / "out"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=environment,
        )
        try:
            process.wait(timeout=randomness.uniform(0.5, 5))
            break
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL if attempt % 2 == 0 else signal.SIGINT)
            assert process.wait(timeout=60) in (-signal.SIGKILL, 130, 0)
    done = tt3d("run", finished / "small.toml", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert hashes(tmp_path / "out") == hashes(finished / "out")


def test_assets_are_in_the_inputs_coordinates(finished: Path) -> None:
    # In its own scene the hen is about 1.4 units tall, around the origin.
    info = json.loads(tt3d("info", finished / "out/asset/clean.glb", "--json").stdout)
    frame = json.loads((finished / "out/asset/views.json").read_text())
    for low, high, centre in zip(info["low"], info["high"], frame["centre"], strict=True):
        assert low < centre < high
    assert 2 < frame["distance"] < 6


def write_ball(folder: Path, centre: np.ndarray, radius: float) -> None:
    """Write a NeRF-synthetic capture of a ball, coloured by direction, seen from all sides."""
    size, angle, distance = 64, 0.7, 4 * radius
    rows, columns = np.mgrid[0:size, 0:size] + 0.5
    focal = 0.5 * size / np.tan(0.5 * angle)
    ray = np.stack(
        [(columns - size / 2) / focal, (size / 2 - rows) / focal, -np.ones((size, size))]
    )
    ray /= np.linalg.norm(ray, axis=0)
    count = 40
    height = 1 - 2 * (np.arange(count) + 0.5) / count
    turn = np.pi * (1 + 5**0.5) * np.arange(count)
    frames: dict[str, list] = {"train": [], "test": []}
    for i in range(count):
        flat = np.sqrt(1 - height[i] ** 2)
        back = np.array([flat * np.cos(turn[i]), flat * np.sin(turn[i]), height[i]])
        right = np.cross([0, 0, 1], back) / np.linalg.norm(np.cross([0, 0, 1], back))
        axes = np.stack([right, np.cross(back, right), back], axis=1)
        # |distance * back + t * d| = radius
        d = np.einsum("ij,jrc->irc", axes, ray)
        along = np.einsum("i,irc->rc", distance * back, d)
        inside = along**2 - distance**2 + radius**2
        t = -along - np.sqrt(np.maximum(inside, 0))
        normal = (distance * back[:, None, None] + t * d) / radius
        colour = np.moveaxis(255 * (0.5 + 0.4 * normal), 0, 2)
        pixels = np.dstack([colour, 255 * (inside > 0)]).clip(0, 255).astype(np.uint8)
        split = "test" if i % 16 == 0 else "train"
        (folder / split).mkdir(parents=True, exist_ok=True)
        Image.fromarray(pixels).save(folder / f"{split}/r_{i}.png")
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = axes, centre + distance * back
        frame = {"file_path": f"./{split}/r_{i}", "transform_matrix": pose.tolist()}
        frames[split].append(frame)
    for split, views in frames.items():
        file = folder / f"transforms_{split}.json"
        file.write_text(json.dumps({"camera_angle_x": angle, "frames": views}))


# A ball near the origin whose scale is the hen's, 0.92, and a ball far away in other units. Of this
# small capture, the visual hull is 8 % larger than the ball: the ball has radius 0.88 inside.
@pytest.mark.parametrize(
    ("centre", "radius"), [((0.02, -0.03, 0.01), 0.958), ((400.0, -250.0, 80.0), 60.0)]
)
def test_exported_files_have_the_inputs_units(
    tmp_path: Path, centre: tuple[float, float, float], radius: float
) -> None:
    write_ball(tmp_path / "ball", np.array(centre), radius)
    photos = json.loads(tt3d("info", tmp_path / "ball", "--json").stdout)
    assert photos["scale"] == pytest.approx(0.88 / radius, rel=0.02)
    (tmp_path / "ball.toml").write_text(SMALL.replace(str(CAPTURE), str(tmp_path / "ball")))
    run = tmp_path / "out"
    done = tt3d("run", tmp_path / "ball.toml", "--out", run, "--set", "attack.steps=4")
    assert done.returncode == 0, done.stderr
    trimesh = pytest.importorskip("trimesh")
    bounds = {"ply": trimesh.load(run / "mesh/mesh.ply", process=False).bounds}
    for name in ("clean.glb", "clean.obj", "adversarial.glb", "adversarial.obj"):
        info = json.loads(tt3d("info", run / "asset" / name, "--json").stdout)
        bounds[name] = np.array([info["low"], info["high"]])
    # A field this small leaves dents, but the masks fix the bounds. Without the transform back, the
    # radius would be 0.88.
    for name, (low, high) in bounds.items():
        assert (high - low).mean() / 2 == pytest.approx(radius, rel=0.03), name
        assert (high + low) / 2 == pytest.approx(np.array(centre), abs=0.03 * radius), name
    for kind in ("clean", "adversarial"):
        assert bounds[f"{kind}.glb"] == pytest.approx(bounds[f"{kind}.obj"], rel=1e-5, abs=1e-5)


def test_changed_configuration_is_refused(finished: Path) -> None:
    done = tt3d("run", finished / "small.toml", "--out", finished / "out", "--set", "attack.beta=5")
    assert done.returncode == 2
    assert "attack.beta" in done.stderr and "--restart" in done.stderr


def test_evaluate_scores_the_exported_files_again(finished: Path, tmp_path: Path) -> None:
    asset = finished / "out/asset"
    done = tt3d(
        "evaluate",
        asset / "adversarial.obj",
        "--clean",
        asset / "clean.obj",
        "--target",
        "teapot",
        "--true-class",
        "cup",
        "--victims",
        MODEL,
        "--views",
        "8",
        "--size",
        "48",
        "--seed",
        "3",
        "--out",
        tmp_path / "e.json",
        "--json",
    )
    assert done.returncode == 0, done.stderr
    record = json.loads(done.stdout)
    builtin = json.loads((finished / "out/eval/builtin.json").read_text())
    assert record["victims"][0]["asr"] == builtin["victims"][0]["asr"]
    assert record["naturalness"]["psnr"] == pytest.approx(builtin["naturalness"]["psnr"], abs=0.05)


def test_render_makes_a_capture(finished: Path, tmp_path: Path) -> None:
    done = tt3d(
        "render",
        finished / "out/asset/clean.glb",
        "--views",
        "3",
        "--size",
        "40",
        "--out",
        tmp_path / "views",
    )
    assert done.returncode == 0, done.stderr
    info = json.loads(tt3d("info", tmp_path / "views", "--json").stdout)
    assert info["train_views"] + info["test_views"] == 3 and info["masks"] is True


def test_attack_again_with_another_method_and_bake(finished: Path, tmp_path: Path) -> None:
    run = shutil.copytree(finished / "out", tmp_path / "out")
    attack = ["attack", run, "--surrogate", MODEL, "--target", "teapot", "--method", "mesh"]
    assert tt3d(*attack).returncode == 0
    config = json.loads((run / "run.json").read_text())["config"]
    assert config["attack.optimize"] == ["vertex-colors", "vertices"]
    assert config["attack.steps"] == 15  # the value of the file, as before
    done = tt3d("bake", run)
    assert done.returncode == 0, done.stderr
    assert hashes(run)["asset/clean.glb"] == hashes(finished / "out")["asset/clean.glb"]
    assert hashes(run)["asset/adversarial.glb"] != hashes(finished / "out")["asset/adversarial.glb"]


def test_untargeted_needs_the_true_class_and_no_target(finished: Path, tmp_path: Path) -> None:
    run = shutil.copytree(finished / "out", tmp_path / "out")
    attack = ["attack", run, "--surrogate", MODEL, "--set", "attack.goal=untargeted"]
    one_line(tt3d(*attack, "--set", "evaluate.true_class=''"), 2, "evaluate.true_class")
    assert tt3d(*attack, "--true-class", "cup").returncode == 0


QUICK = [
    word
    for setting in (
        "attack.steps=3", "attack.views_per_step=2", "attack.image_size=48", "bake.resolution=256",
        "attack.texture_size=64", "attack.tile_size=16", "field.appearance.finest=128",
        "field.appearance.log2_size=13",
    )
    for word in ("--set", setting)
]  # fmt: skip


def span(path: Path) -> list[float]:
    """Return the lowest and highest x, y and z of an OBJ file's vertices."""
    lines = [line.split()[1:4] for line in path.read_text().splitlines() if line[:2] == "v "]
    axes = list(zip(*(map(float, line) for line in lines), strict=True))
    return [edge for axis in axes for edge in (min(axis), max(axis))]


@pytest.mark.parametrize("method", ["dual", "mesh", "texture", "physical"])
def test_an_asset_takes_the_place_of_a_capture(finished: Path, tmp_path: Path, method: str) -> None:
    asset, run = tmp_path / "thing.glb", tmp_path / "run"
    shutil.copy(finished / "out/asset/clean.glb", asset)
    attack = ["attack", run, "--surrogate", MODEL, "--target", "teapot", *QUICK]
    done = tt3d(*attack, "--asset", asset, "--method", method)
    assert done.returncode == 0, done.stderr
    done = tt3d("bake", run)
    assert done.returncode == 0, done.stderr
    # The bounds are in the asset's coordinates; three steps hardly move a vertex.
    before, after = span(finished / "out/asset/clean.obj"), span(run / "asset/adversarial.obj")
    assert after == pytest.approx(before, abs=0.02)
    one_line(tt3d("report", run), 2, "evaluate.victims")
    done = tt3d("report", run, "--set", f'evaluate.victims=["{MODEL}"]', "--set",
                "evaluate.views=4", "--set", 'evaluate.true_class="cup"')  # fmt: skip
    assert done.returncode == 0, done.stderr
    page = (run / "report.html").read_text()
    assert "taken for" in page and "Field, test views" not in page
    shutil.copy(asset, tmp_path / "other.glb")
    one_line(tt3d(*attack, "--asset", tmp_path / "other.glb"), 2, "another object")


def test_a_configuration_may_begin_with_an_asset(finished: Path, tmp_path: Path) -> None:
    shutil.copy(finished / "out/asset/clean.glb", tmp_path / "thing.glb")
    config = re.sub(r"\[capture\][^\[]*", '[asset]\npath = "thing.glb"\n',
                    (finished / "small.toml").read_text())  # fmt: skip
    (tmp_path / "asset.toml").write_text(config)
    done = tt3d("run", tmp_path / "asset.toml", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    stages = json.loads((tmp_path / "out/run.json").read_text())["stages"]
    assert [s["name"] for s in stages] == ["mesh", "attack", "bake", "evaluate", "report"]
    assert (tmp_path / "out/report.html").is_file()


def test_one_tile_for_two_objects(finished: Path, tmp_path: Path) -> None:
    runs = [shutil.copytree(finished / "out", tmp_path / name) for name in ("a", "b")]
    attack = ["attack", runs[0], "--surrogate", MODEL, "--target", "teapot", *QUICK]
    done = tt3d(*attack, "--method", "triplanar", "--also", runs[1])
    assert done.returncode == 0, done.stderr
    tiles = []
    for run in runs:
        tiles.append(load_file(run / "attack/attack.safetensors")["tile"])
        config = json.loads((run / "run.json").read_text())["config"]
        assert config["attack.method"] == "triplanar"
        assert tt3d("bake", run).returncode == 0
    assert (tiles[0] == tiles[1]).all()
    one_line(tt3d(*attack, "--method", "dual", "--also", runs[1]), 2, "attack.also")
    one_line(tt3d(*attack, "--also", tmp_path / "nothing"), 2, "nothing")
    assert tt3d(*attack, "--method", "dual").returncode == 0  # alone again


def test_a_mask_keeps_the_rest_of_the_texture(finished: Path, tmp_path: Path) -> None:
    run = shutil.copytree(finished / "out", tmp_path / "out")
    clean = Image.open(run / "asset/clean.png")
    mask = Image.new("L", clean.size, 0)
    mask.paste(255, (0, 0, clean.width // 2, clean.height))
    mask.save(tmp_path / "mask.png")
    attack = ["attack", run, "--surrogate", MODEL, "--target", "teapot", *QUICK]
    done = tt3d(*attack, "--method", "sticker", "--sticker-mask", tmp_path / "mask.png")
    assert done.returncode == 0, done.stderr
    assert tt3d("bake", run).returncode == 0
    before = np.asarray(clean).astype(int)
    change = np.abs(np.asarray(Image.open(run / "asset/adversarial.png")).astype(int) - before)
    # Triangles cross the line, but none reaches a tenth of the width beyond it.
    assert change[:, : clean.width // 2].max() > 0
    assert change[:, clean.width * 6 // 10 :].max() == 0


def test_a_detector_is_checked_and_attacked(finished: Path, tmp_path: Path) -> None:
    detector = MODEL.with_name("toy_detector.pt2")
    done = tt3d("model", "check", detector)  # compares logits and gradient with the card
    assert done.returncode == 0, done.stderr
    run = shutil.copytree(finished / "out", tmp_path / "out")
    assert "detector with" in done.stdout and "anchors" in done.stdout
    facts = json.loads(tt3d("info", detector, "--json").stdout)
    assert facts["kind"] == "detector" and facts["anchors"] > 1 and facts["scores"] == "sigmoid"
    done = tt3d("attack", run, "--surrogate", detector, "--target", "teapot", *QUICK)
    assert done.returncode == 0, done.stderr


def test_the_scores_of_a_detector_do_not_compete(finished: Path, tmp_path: Path) -> None:
    """The card decides between sigmoid and softmax; only softmax makes a sum of one."""
    card = json.loads(MODEL.with_name("toy_detector.json").read_text())
    sums = {}
    for scores in ("sigmoid", "softmax"):
        shutil.copy(MODEL.with_name("toy_detector.pt2"), tmp_path / f"{scores}.pt2")
        (tmp_path / f"{scores}.json").write_text(json.dumps({**card, "scores": scores}))
        picture = finished / "out/asset/clean.png"
        done = tt3d("model", "classify", tmp_path / f"{scores}.pt2", picture, "--json",
                    "--top", len(card["labels"]))  # fmt: skip
        assert done.returncode == 0, done.stderr
        top = json.loads(done.stdout)["images"][0]["top"]
        sums[scores] = sum(one["probability"] for one in top)
    assert sums["softmax"] == pytest.approx(1, abs=1e-4)
    assert abs(sums["sigmoid"] - 1) > 0.1


def test_victims_with_different_labels(finished: Path, tmp_path: Path) -> None:
    """A name may be given for each label set; a bare index is refused."""
    card = json.loads(MODEL.with_suffix(".json").read_text())
    labels = [f"thing {i}" for i in range(len(card["labels"]))]
    shutil.copy(MODEL, tmp_path / "other.pt2")
    other = {**card, "name": "other", "labels": labels, "label_set": "things"}
    (tmp_path / "other.json").write_text(json.dumps(other))
    words = ["evaluate", finished / "out/asset/adversarial.glb", "--clean",
             finished / "out/asset/clean.glb", "--victims", MODEL, tmp_path / "other.pt2",
             "--views", 4, "--size", 48, "--out", tmp_path / "r.json"]  # fmt: skip
    one_line(tt3d(*words, "--target", "3"), 2, "an index means another class in other")
    one_line(tt3d(*words, "--target", "teapot"), 2, "model other has no such class")
    one_line(tt3d(*words, "--target", "toy_cnn=teapot"), 2, "add things=CLASS")
    done = tt3d(*words, "--target", "toy_cnn=teapot,things=thing 3",
                "--true-class", "toy_cnn=cup,things=6")  # fmt: skip
    assert done.returncode == 0, done.stderr
    victims = json.loads((tmp_path / "r.json").read_text())["victims"]
    assert [v["target"]["name"] for v in victims] == ["teapot", "thing 3"]
    assert [v["true_class"]["name"] for v in victims] == ["cup", "thing 6"]
    # It is the same network, so the figures are equal.
    for key in ("asr", "clean_accuracy", "mean_target_probability"):
        assert victims[0][key] == victims[1][key]


def test_a_seed_holds_from_its_stage_on(finished: Path, tmp_path: Path) -> None:
    run = shutil.copytree(finished / "out", tmp_path / "out")
    attack = ["attack", run, "--surrogate", MODEL, "--target", "teapot", *QUICK]
    results = []
    for seed in (5, 6):
        assert tt3d(*attack, "--seed", seed).returncode == 0
        results.append(hashes(run)["attack/attack.safetensors"])
    assert results[0] != results[1]
    stages = json.loads((run / "run.json").read_text())["stages"]
    assert {s["name"]: s["seed"] for s in stages} == {"field": 3, "mesh": 3, "attack": 6}
    one_line(tt3d("report", run, "--seed", 6), 2, "draws nothing at random")


def test_an_input_that_changed_under_a_finished_stage_is_refused(
    finished: Path, tmp_path: Path
) -> None:
    asset, run, model = tmp_path / "thing.glb", tmp_path / "run", tmp_path / "m.pt2"
    shutil.copy(finished / "out/asset/clean.glb", asset)
    for suffix in (".pt2", ".json"):
        shutil.copy(MODEL.with_suffix(suffix), model.with_suffix(suffix))
    attack = ["attack", run, "--surrogate", model, "--target", "teapot", *QUICK, "--asset", asset]
    assert tt3d(*attack).returncode == 0
    was = model.read_bytes()
    model.write_bytes(was + b"x")
    one_line(tt3d("bake", run), 2, "m.pt2: has changed since stage 'attack' read it")
    model.write_bytes(was)
    was = asset.read_bytes()
    asset.write_bytes(was[:-1] + b"x")
    one_line(tt3d("bake", run), 2, "thing.glb: has changed since stage 'mesh' read it")
    asset.write_bytes(was)
    assert tt3d("bake", run, "--restart").returncode == 0


def test_a_photograph_that_changed_is_refused(finished: Path, tmp_path: Path) -> None:
    capture, run = shutil.copytree(CAPTURE, tmp_path / "capture"), tmp_path / "out"
    text = SMALL.replace(str(CAPTURE), str(capture)).replace("steps = 200", "steps = 20")
    (tmp_path / "small.toml").write_text(text)
    fit = ["run", tmp_path / "small.toml", "--out", run]
    assert tt3d(*fit).returncode == 0
    photo = next(p for p in sorted(capture.rglob("*")) if p.suffix in (".jpg", ".png"))
    with photo.open("ab") as stream:
        stream.write(b"x")
    one_line(tt3d(*fit), 2, f"{photo}: has changed since stage 'field' read it")


def test_curves_become_event_files(finished: Path, tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    run = shutil.copytree(finished / "out", tmp_path / "out")
    command = [sys.executable, "-m", "tt3d_tools.event_files", run]
    environment = os.environ | {"PYTHONPATH": str(ROOT / "python")}
    subprocess.run(command, check=True, env=environment, capture_output=True, timeout=120)
    events = EventAccumulator(str(run / "attack/tensorboard"))
    events.Reload()
    lines = (run / "attack/curves.csv").read_text().splitlines()
    loss = lines[0].split(",").index("loss")
    written = [(e.step, e.value) for e in events.Scalars("curves/loss")]
    assert written == [
        (int(row[0]), pytest.approx(float(row[loss]), rel=1e-5))
        for row in (line.split(",") for line in lines[1:])
    ]
    failed = subprocess.run([*command[:3], tmp_path], env=environment, capture_output=True,
                            text=True, timeout=120, check=False)  # fmt: skip
    assert failed.returncode == 2 and "curves.csv" in failed.stderr


def test_attack_lists_its_methods() -> None:
    listed = tt3d("attack", "--list")
    assert listed.returncode == 0
    assert "dual" in listed.stdout and "CVPR 2024" in listed.stdout
    methods = json.loads(tt3d("attack", "--json", "--list").stdout)
    assert {"dual", "mesh", "paper", "strong"} <= {m["method"] for m in methods}
    assert all(m["optimises"] and m["source"] for m in methods)


def test_every_method_has_a_row_in_the_page() -> None:
    page = (ROOT / "docs/attack.md").read_text()
    for method in json.loads(tt3d("attack", "--json", "--list").stdout):
        assert f"`{method['method']}`" in page


def test_every_transform_has_a_row_in_the_page() -> None:
    page = (ROOT / "docs/attack.md").read_text()
    for key in json.loads(tt3d("config", "attack.eot", "--json").stdout):
        assert f"`{key['key']}`" in page, key["key"]


def test_key_tables_of_the_documentation_are_those_of_the_program() -> None:
    check = [sys.executable, ROOT / "scripts/key-tables", "--check"]
    environment = os.environ | {"TT3D": str(PROGRAM)}
    done = subprocess.run(check, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def one_line(done: subprocess.CompletedProcess[str], code: int, *parts: str) -> None:
    """Check that the program ended with this code and one line that has these parts."""
    assert done.returncode == code, done.stderr
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    assert len(lines) == 1, done.stderr
    for part in parts:
        assert part in lines[0], lines[0]


def small(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    """Write the small configuration with replacements to a file."""
    text = SMALL
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "c.toml").write_text(text)
    return tmp_path / "c.toml"


def test_unknown_key(tmp_path: Path) -> None:
    config = small(tmp_path, ("views_per_step", "view_per_step"))
    one_line(tt3d("run", config, "--out", tmp_path / "o"), 2, "c.toml:", "attack.views_per_step")


def test_missing_config_and_capture(tmp_path: Path) -> None:
    one_line(tt3d("run", tmp_path / "none.toml"), 2, "none.toml")
    config = small(tmp_path, (str(CAPTURE), str(tmp_path / "nowhere")))
    one_line(tt3d("run", config, "--out", tmp_path / "o"), 2, "nowhere")


def test_truncated_photograph(tmp_path: Path) -> None:
    shutil.copytree(CAPTURE, tmp_path / "hen")
    picture = sorted((tmp_path / "hen/train").glob("*.png"))[0]
    picture.write_bytes(picture.read_bytes()[:500])
    one_line(tt3d("info", tmp_path / "hen"), 2, picture.name)


def test_unknown_class(finished: Path, tmp_path: Path) -> None:
    done = tt3d(
        "evaluate",
        finished / "out/asset/clean.glb",
        "--target",
        "teapott",
        "--victims",
        MODEL,
        "--out",
        tmp_path / "e.json",
    )
    one_line(done, 2, "teapott", "teapot")


def test_an_iso_above_every_density_is_bounded_and_gives_a_mesh(tmp_path: Path) -> None:
    config = small(
        tmp_path,
        ("resolution = 64", "resolution = 64\niso = 1000000.0"),
        ("steps = 200", "steps = 1"),
    )
    done = tt3d("run", config, "--out", tmp_path / "o")
    assert done.returncode == 0, done.stderr
    mesh = json.loads((tmp_path / "o/mesh/metrics.json").read_text())
    assert mesh["closed"] is True and mesh["faces"] > 100


def test_empty_mesh(tmp_path: Path) -> None:
    """A field with an empty occupancy grid has no surface; one line says what to change."""
    run = tmp_path / "o"
    fast = ["field.steps=1", "field.occupancy=64", "mesh.resolution=32", "capture.max_size=64"]
    settings = [word for setting in fast for word in ("--set", setting)]
    assert tt3d("fit", CAPTURE, "--out", run, *settings).returncode == 0
    path = run / "field/field.safetensors"
    with safe_open(path, "numpy") as file:
        metadata = file.metadata()
    tensors = load_file(path)
    assert tensors["occupied"].any()
    tensors["occupied"] = np.zeros_like(tensors["occupied"])
    save_file(tensors, path, metadata)
    one_line(tt3d("mesh", run), 2, "field.steps", "mesh.iso")


def test_folder_that_cannot_be_written(tmp_path: Path) -> None:
    one_line(tt3d("run", small(tmp_path), "--out", "/proc/tt3d"), 5, "/proc/tt3d")


def test_full_disk(tmp_path: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("needs root to mount a small file system")
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=300k", "tmpfs", disk]
    mounted = subprocess.run(mount, check=False)
    if mounted.returncode != 0:
        pytest.skip("cannot mount here")
    try:
        done = tt3d("run", small(tmp_path), "--out", disk / "o")
        one_line(done, 5, str(disk))
        assert not list(disk.rglob("*.tmp*"))
    finally:
        subprocess.run(["umount", disk], check=True)


def test_usage_errors_are_exit_code_2() -> None:
    assert tt3d().returncode == 2
    assert tt3d("run").returncode == 2
    assert tt3d("--help").returncode == 0
    assert tt3d("config", "--device", "gpu").returncode == 2


def test_config_lists_every_key_with_its_default() -> None:
    keys = json.loads(tt3d("config", "--json").stdout)
    assert {"attack.beta", "seed", "evaluate.views"} <= {key["key"] for key in keys}
    one_line(tt3d("config", "attack.betta"), 2, "attack.beta")
