"""Score rendered videos: turntables, boxes, labels, tracking, bad files."""

from __future__ import annotations

import csv
import itertools
import json
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

np = pytest.importorskip("numpy")
Image = pytest.importorskip("PIL.Image")
sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "python/tt3d_tools"))
from tool_support import PROGRAM, TOY, tt3d, write_asset  # noqa: E402

pytestmark = [
    pytest.mark.skipif(not PROGRAM.exists(), reason=f"{PROGRAM} is not built"),
    pytest.mark.skipif(
        shutil.which("ffmpeg") is None, reason="ffmpeg is not installed (scripts/setup --all)"
    ),
]


def ffmpeg(*words: object) -> None:
    subprocess.run(["ffmpeg", "-v", "error", "-y", *map(str, words)], check=True)


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a turntable video of 2 s, blurred and compressed."""
    folder = tmp_path_factory.mktemp("video")
    obj = write_asset(folder)
    done = tt3d(
        "render", obj, "--video", "--seconds", 2, "--fps", 10, "--size", 160, "--blur", 2,
        "--crf", 30, "--background", "#3060a0", "--out", folder / "turn.mp4",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return folder / "turn.mp4"


def score(video: Path, out: Path, *options: object) -> tuple[dict, list[dict[str, str]]]:
    done = tt3d(
        "video-score", video, "--target", 1, "--victims", TOY, "--out", out / "score.json", *options
    )
    assert done.returncode == 0, done.stderr
    rows = list(csv.DictReader((out / "score.csv").open()))
    return json.loads((out / "score.json").read_text()), rows


def test_the_turntable_is_a_video_of_its_length(video: Path) -> None:
    from video_frames import probe

    facts = probe(str(video))
    assert (facts["width"], facts["height"]) == (160, 160)
    assert facts["duration"] == pytest.approx(2, abs=0.11)
    assert facts["rate"] == pytest.approx(10)


def test_shares_can_be_counted_again_from_the_rows(video: Path, tmp_path: Path) -> None:
    table = tmp_path / "backgrounds.csv"
    table.write_text("start_seconds,end_seconds,label\n0,1,blue paper\n1,1.5,same again\n")
    record, rows = score(video, tmp_path, "--frames", 10, "--backgrounds", table)
    assert len(rows) == 10 == record["frames"]
    hits = [row["top1_index"] == "1" for row in rows]
    (victim,) = record["victims"]
    assert victim["asr"] == pytest.approx(sum(hits) / 10)
    paper = [h for h, row in zip(hits, rows, strict=True) if row["background"] == "blue paper"]
    assert victim["backgrounds"]["blue paper"]["frames"] == len(paper) == 5
    assert victim["backgrounds"]["blue paper"]["asr"] == pytest.approx(sum(paper) / len(paper))
    assert sum(b["frames"] for b in victim["backgrounds"].values()) == 10
    page = (tmp_path / "score.html").read_text()
    assert page.count("<img ") == 10 and "blue paper" in page
    strip = record["strip"]
    assert [f["seconds"] for f in strip] == [float(row["seconds"]) for row in rows]
    assert [f["answers"][0]["is_target"] for f in strip] == hits
    first = Image.open(tmp_path / "score.frames" / strip[0]["picture"])
    assert first.size == (160, 160) and len(list((tmp_path / "score.frames").iterdir())) == 10


def test_a_moving_camera_in_blender_before_two_backgrounds(tmp_path: Path) -> None:
    """The video is like one of a phone: light, shadow, ground, motion blur, compression."""
    if shutil.which("blender") is None:
        pytest.skip("blender is not installed (scripts/setup --all)")
    from video_frames import sample

    obj = write_asset(tmp_path)
    backgrounds = {"field": "#406030", "wall": "#b08060"}
    for name, color in backgrounds.items():
        done = tt3d(
            "render", obj, "--video", "--renderer", "blender", "--lit", "--samples", 4,
            "--seconds", 1, "--fps", 4, "--size", 96, "--blur", 2, "--crf", 32,
            "--elevation", 3, "--background", color, "--out", tmp_path / f"{name}.mp4",
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
    (tmp_path / "list.txt").write_text("file field.mp4\nfile wall.mp4\n")
    take = tmp_path / "take.mp4"
    ffmpeg("-f", "concat", "-i", tmp_path / "list.txt", "-c", "copy", take)
    (tmp_path / "takes.csv").write_text("0,1,field\n1,2,wall\n")
    record, rows = score(take, tmp_path, "--frames", 8, "--backgrounds", tmp_path / "takes.csv")
    assert [r["background"] for r in rows] == ["field"] * 4 + ["wall"] * 4
    shares = record["victims"][0]["backgrounds"]
    assert {label: s["frames"] for label, s in shares.items()} == {"field": 4, "wall": 4}
    job = {"video": str(take), "frames": 8, "box": "", "mask": "", "track": False,
           "folder": str(tmp_path)}  # fmt: skip
    frames = [np.asarray(Image.open(f["file"]), float) for f in sample(job)["frames"]]
    wanted = [tuple(bytes.fromhex(c[1:])) for c in backgrounds.values() for _ in range(4)]
    for frame, color in zip(frames, wanted, strict=True):
        assert np.abs(frame[:6, :6].mean((0, 1)) - color).max() < 25
        grey = frame[-6:, :6].mean((0, 1))
        assert np.ptp(grey) < 25 and 60 < grey.mean() < 230  # the ground, lit or in shadow
    assert min(np.abs(a - b).mean() for a, b in itertools.pairwise(frames)) > 1


def test_the_rotation_tag_of_a_phone_is_applied(video: Path, tmp_path: Path) -> None:
    """A frame of 96 x 64 is upright when rotated clockwise: the red edge is at the top."""
    picture = np.zeros((64, 96, 3), np.uint8)
    picture[:, :16] = (255, 0, 0)
    Image.fromarray(picture).save(tmp_path / "frame.png")
    ffmpeg("-loop", 1, "-i", tmp_path / "frame.png", "-t", 1, "-pix_fmt", "yuv420p",
           tmp_path / "flat.mp4")  # fmt: skip
    ffmpeg("-i", tmp_path / "flat.mp4", "-c", "copy", "-metadata:s:v:0", "rotate=270",
           tmp_path / "turned.mp4")  # fmt: skip
    from video_frames import sample

    job = {"video": str(tmp_path / "turned.mp4"), "frames": 2, "box": "", "mask": "",
           "track": False, "folder": str(tmp_path)}  # fmt: skip
    found = sample(job)
    assert (found["width"], found["height"]) == (64, 96)
    upright = np.asarray(Image.open(found["frames"][0]["file"]), float)
    assert upright.shape[:2] == (96, 64)
    assert upright[:10, :, 0].mean() > 200 and upright[30:, :, 0].mean() < 60


def frames_of(video: Path, folder: Path, count: int = 6) -> dict:
    from video_frames import sample

    return sample({"video": str(video), "frames": count, "box": "", "mask": "", "track": False,
                   "folder": str(folder)})  # fmt: skip


def test_files_without_a_duration_are_read_to_the_end(tmp_path: Path) -> None:
    """A browser writes WebM in live mode, and a camera writes a raw stream."""
    source = ("-f", "lavfi", "-i", "testsrc=size=64x48:rate=12", "-t", 2)
    ffmpeg(*source, "-c:v", "libvpx", "-f", "webm", "-live", 1, tmp_path / "live.webm")
    ffmpeg(*source, "-c:v", "libx264", "-f", "h264", tmp_path / "raw.h264")
    for name in ("live.webm", "raw.h264"):
        found = frames_of(tmp_path / name, tmp_path)
        assert len(found["frames"]) == 6, name
        assert found["duration"] == pytest.approx(2, abs=0.15), name


def test_pixels_that_are_not_square_are_shown_in_shape(tmp_path: Path) -> None:
    source = ("-f", "lavfi", "-i", "testsrc=size=240x240:rate=5", "-t", 1, "-vf", "setsar=4/3")
    ffmpeg(*source, "-pix_fmt", "yuv420p", tmp_path / "wide.mp4")
    found = frames_of(tmp_path / "wide.mp4", tmp_path, 2)
    assert (found["width"], found["height"]) == (320, 240)
    assert Image.open(found["frames"][0]["file"]).size == (320, 240)
    ffmpeg("-i", tmp_path / "wide.mp4", "-c", "copy", "-metadata:s:v:0", "rotate=90",
           tmp_path / "tall.mp4")  # fmt: skip
    found = frames_of(tmp_path / "tall.mp4", tmp_path, 2)
    assert (found["width"], found["height"]) == (240, 320)
    assert Image.open(found["frames"][0]["file"]).size == (240, 320)


def test_a_late_start_does_not_count_as_duration(tmp_path: Path) -> None:
    ffmpeg("-f", "lavfi", "-i", "testsrc=size=64x48:rate=12", "-t", 2, "-output_ts_offset", 5,
           tmp_path / "late.mkv")  # fmt: skip
    found = frames_of(tmp_path / "late.mkv", tmp_path)
    assert found["duration"] == pytest.approx(2, abs=0.1)
    assert len(found["frames"]) == 6
    assert found["frames"][-1]["seconds"] < 2


def test_victims_with_other_label_orders_have_their_own_target(video: Path, tmp_path: Path) -> None:
    """The same network twice, once with its labels in reverse order: other index, same figures."""
    card = json.loads(TOY.with_suffix(".json").read_text())
    labels = [f"class{i}" for i in range(len(card["labels"]))]
    for name, ordered in (("plain", labels), ("reversed", labels[::-1])):
        (tmp_path / f"{name}.pt2").write_bytes(TOY.read_bytes())
        text = json.dumps({**card, "name": name, "labels": ordered})
        (tmp_path / f"{name}.json").write_text(text)
    victims = [str(tmp_path / f"{name}.pt2") for name in ("plain", "reversed")]
    done = tt3d("video-score", video, "--target", "class1", "--victims", *victims, "--frames", 5,
                "--out", tmp_path / "score.json")  # fmt: skip
    assert done.returncode == 0, done.stderr
    rows = list(csv.DictReader((tmp_path / "score.csv").open()))
    record = json.loads((tmp_path / "score.json").read_text())
    indices = {"plain": 1, "reversed": len(labels) - 2}
    for victim in record["victims"]:
        target = indices[victim["name"]]
        assert victim["target"]["index"] == target
        own = [r for r in rows if r["victim"] == victim["name"]]
        hits = sum(int(r["top1_index"]) == target for r in own)
        assert victim["asr"] == pytest.approx(hits / len(own))
        shown = [a["is_target"] for f in record["strip"] for a in f["answers"]
                 if a["victim"] == victim["name"]]  # fmt: skip
        assert sum(shown) == hits
    refused = tt3d("video-score", video, "--target", 1, "--victims", *victims)
    assert refused.returncode == 2 and "an index means another class" in refused.stderr


def test_a_box_and_a_mask_cut_the_same(video: Path, tmp_path: Path) -> None:
    mask = np.zeros((80, 80), np.uint8)
    mask[10:60, 20:50] = 255  # at half the video's size
    Image.fromarray(mask).save(tmp_path / "mask.png")
    _, boxed = score(video, tmp_path, "--frames", 4, "--box", "40,20,60,100")
    _, masked = score(video, tmp_path, "--frames", 4, "--mask", tmp_path / "mask.png")
    assert boxed == masked
    assert [boxed[0][k] for k in ("left", "top", "right", "bottom")] == ["40", "20", "100", "120"]


def test_a_tracker_follows(tmp_path: Path) -> None:
    """Make a video of a textured square that moves 60 pixels to the right."""
    pytest.importorskip("cv2")
    random = np.random.default_rng(3)
    patch = random.integers(0, 256, (40, 40, 3)).astype(np.uint8)
    still = np.full((160, 240, 3), 90, np.uint8)
    for i in range(30):
        frame = still.copy()
        frame[60:100, 40 + 2 * i : 80 + 2 * i] = patch
        Image.fromarray(frame).save(tmp_path / f"f{i:03}.png")
    ffmpeg("-framerate", 10, "-i", tmp_path / "f%03d.png", "-crf", 10, tmp_path / "moves.mp4")
    _, rows = score(tmp_path / "moves.mp4", tmp_path, "--frames", 10, "--box", "36,56,48,48",
                    "--track")  # fmt: skip
    moved = int(rows[-1]["left"]) - int(rows[0]["left"])
    seconds = float(rows[-1]["seconds"]) - float(rows[0]["seconds"])
    assert moved == pytest.approx(20 * seconds, abs=6)


def sample_measured(video: Path, frames: int) -> tuple[int, int, int]:
    """Return the sampled frames, and the peak memory in kB of the sampling and of ffmpeg."""
    script = (
        "import json, resource, sys\n"
        "sys.path.insert(0, sys.argv[1])\n"
        "from video_frames import sample\n"
        "found = sample(json.loads(sys.argv[2]))\n"
        # The peak of this program only: ru_maxrss starts with the parent's value.
        "status = open('/proc/self/status').read()\n"
        "peak = int(status.split('VmHWM:')[1].split()[0])\n"
        "child = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss\n"
        "print(len(found['frames']), peak, child)\n"
    )
    job = {"video": str(video), "frames": frames, "box": "", "mask": "",
           "track": False, "folder": str(video.parent)}  # fmt: skip
    tools = str(Path(__file__).resolve().parents[2] / "python/tt3d_tools")
    done = subprocess.run(
        [sys.executable, "-c", script, tools, json.dumps(job)], capture_output=True, text=True
    )
    sampled, peak, child = map(int, done.stdout.split()[-3:])
    return sampled, peak, child


def test_memory_does_not_grow_with_the_video(tmp_path: Path) -> None:
    """Sampling 4K frames at 60 a second does not keep decoded frames in memory."""
    ffmpeg("-f", "lavfi", "-i", "testsrc2=size=3840x2160:rate=60:duration=2", "-preset",
           "ultrafast", tmp_path / "large.mp4")  # fmt: skip
    frames, peak, child = sample_measured(tmp_path / "large.mp4", 30)
    assert frames == 30
    assert peak < 400_000 and child < 1_500_000  # kB; 30 frames of 4K alone are 750 MB


def test_ten_minutes_of_4k_take_seconds(tmp_path: Path) -> None:
    """Seek in 36,000 frames of 4K; decoding all frames would take many minutes."""
    ffmpeg("-f", "lavfi", "-i", "color=teal:size=3840x2160:rate=60:duration=2", "-preset",
           "ultrafast", tmp_path / "two.mp4")  # fmt: skip
    (tmp_path / "list.txt").write_text("file two.mp4\n" * 300)
    ffmpeg("-f", "concat", "-i", tmp_path / "list.txt", "-c", "copy", tmp_path / "ten.mp4")
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    frames, peak, child = sample_measured(tmp_path / "ten.mp4", 30)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime - before.ru_utime
    assert frames == 30
    assert peak < 400_000 and child < 1_500_000  # kB
    assert spent < 200  # processor seconds; decoding all frames takes thousands


def test_frames_far_apart_have_the_right_time(tmp_path: Path) -> None:
    """In a minute that brightens evenly, every sixth second is sampled."""
    from video_frames import sample

    ffmpeg("-f", "lavfi", "-i", "nullsrc=size=64x48:rate=10:duration=60,geq=lum='16+3.5*T':"
           "cb=128:cr=128", "-g", 300, tmp_path / "dawn.mp4")  # fmt: skip
    job = {"video": str(tmp_path / "dawn.mp4"), "frames": 10, "box": "", "mask": "",
           "track": False, "folder": str(tmp_path)}  # fmt: skip
    found = sample(job)["frames"]
    assert [f["seconds"] for f in found] == pytest.approx([6.0 * i for i in range(10)])
    assert [f["index"] for f in found] == [60 * i for i in range(10)]
    levels = [np.asarray(Image.open(f["file"]), float).mean() for f in found]
    assert levels == pytest.approx([3.5 * 6 * i * 255 / 219 for i in range(10)], abs=4)


@pytest.mark.parametrize("content", [b"", b"not a video at all", b"\0" * 5000])
def test_bad_files(tmp_path: Path, content: bytes) -> None:
    bad = tmp_path / "bad.mp4"
    bad.write_bytes(content)
    done = tt3d("video-score", bad, "--target", 1, "--victims", TOY)
    assert done.returncode == 2 and "bad.mp4" in done.stderr


def test_a_video_without_frames_and_a_cut_one(video: Path, tmp_path: Path) -> None:
    none, cut = tmp_path / "none.mp4", tmp_path / "cut.mp4"
    ffmpeg("-f", "lavfi", "-i", "color=size=64x48", "-frames:v", 0, none)
    done = tt3d("video-score", none, "--target", 1, "--victims", TOY)
    assert done.returncode == 2
    assert "none.mp4" in done.stderr and len(done.stderr.strip().splitlines()) == 1
    cut.write_bytes(video.read_bytes()[: video.stat().st_size // 2])
    done = tt3d("video-score", cut, "--target", 1, "--victims", TOY, "--frames", 10)
    assert done.returncode == 0 and "of 10 frames could be decoded" in done.stderr


def test_bad_options(video: Path, tmp_path: Path) -> None:
    def fails(*options: object) -> str:
        done = tt3d("video-score", video, "--target", 1, "--victims", TOY, *options)
        assert done.returncode == 2
        return done.stderr

    assert (
        "no such video"
        in tt3d("video-score", tmp_path / "absent.mp4", "--target", 1, "--victims", TOY).stderr
    )
    assert "160 x 160" in fails("--box", "100,100,100,100")
    assert "LEFT,TOP" in fails("--box", "1;2;3")
    table = tmp_path / "table.csv"
    table.write_text("0,1,paper\n2,1,wrong order\n")
    assert "table.csv:2" in fails("--backgrounds", table)
    ffmpeg("-f", "lavfi", "-i", "sine=duration=1", tmp_path / "sound.mp4")
    done = tt3d("video-score", tmp_path / "sound.mp4", "--target", 1, "--victims", TOY)
    assert done.returncode == 2 and "no video stream" in done.stderr
