"""Step 1: photographs or a video become pictures of one size limit, upright and sharp."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image, ImageOps

from tt3d_tools import toolkit

SIDE = 1600  # pixels, longest side of the pictures
QUALITY = 95  # of the JPEG files
FEWEST = 10  # photographs; fewer give no closed object
MOST_FRAMES = 120
FEWEST_FRAMES = 40
CANDIDATES = 5  # frames of a window; the sharpest is kept
COPY_LEVELS = 1.0  # mean difference of two small grey pictures that are copies, of 255 levels

PICTURES = {".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp"}
HEIC = {".heic", ".heif"}
VIDEOS = {".mp4", ".mov", ".m4v", ".mkv", ".avi", ".webm", ".3gp", ".mts"}


@dataclass
class Frame:
    """One picture of the capture and what is known of it."""

    name: str
    source: str
    width: int
    height: int
    sharpness: float  # see sharpness()
    brightness: float  # mean grey level, 0 to 255
    focal_px: float  # focal length that the EXIF data state, in pixels; 0: unknown


def sharpness(grey: np.ndarray) -> float:
    """Return how much finer than blurred the picture's strongest edges are, 0 to 1.

    A picture that was blurred loses little when it is blurred again (Crete et al., The Blur Effect,
    2007). The measure uses the gradients of the strongest edges only, so that a plain background
    does not count.
    """
    scale = 800 / max(grey.shape)
    if scale < 1:
        grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    grey = grey.astype(np.float32)
    again = cv2.blur(grey, (9, 9))

    def slope(picture: np.ndarray) -> np.ndarray:
        return np.abs(np.diff(picture, axis=1))[:-1] + np.abs(np.diff(picture, axis=0))[:, :-1]

    before, after = slope(grey), slope(again)
    strong = before >= np.quantile(before, 0.98)
    return float(1 - after[strong].sum() / max(before[strong].sum(), 1e-6))


def small_grey(picture: np.ndarray) -> np.ndarray:
    """Return a grey picture of 32 by 32 pixels, to find copies."""
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    return cv2.resize(grey, (32, 32), interpolation=cv2.INTER_AREA).astype(np.float32)


def is_video(path: Path) -> bool:
    """Tell whether the source is a video file."""
    return path.is_file() and path.suffix.lower() in VIDEOS


def photographs_in(folder: Path) -> list[Path]:
    """Return the photographs of a folder, by name."""
    found = [
        path
        for path in sorted(folder.iterdir())
        if path.is_file()
        and not path.name.startswith(".")
        and path.suffix.lower() in PICTURES | HEIC
    ]
    if not found and (folder / "images").is_dir():
        return photographs_in(folder / "images")
    if len(found) < FEWEST:
        kinds = "JPEG, PNG, WebP, TIFF or HEIC"
        raise toolkit.InputProblem(
            f"{folder}: has {len(found)} photographs ({kinds}), expected at least {FEWEST}; take "
            "30 to 60 from all sides of the object, each overlapping the last by two thirds"
        )
    return found


def read_photograph(path: Path) -> tuple[np.ndarray, float]:
    """Return the upright pixels, at most SIDE long, and the focal length that EXIF states."""
    if path.suffix.lower() in HEIC:
        toolkit.need_package("pillow_heif", f"{path.name}", "pillow-heif").register_heif_opener()
    try:
        with Image.open(path) as image:
            exif = image.getexif()
            focal35 = float(exif.get_ifd(0x8769).get(0xA405, 0) or 0)
            image.draft("RGB", (SIDE, SIDE))
            upright = ImageOps.exif_transpose(image).convert("RGB")
    except (OSError, ValueError, SyntaxError) as error:
        raise toolkit.InputProblem(f"{path}: cannot be read: {error}") from error
    upright.thumbnail((SIDE, SIDE), Image.Resampling.LANCZOS)
    diagonal = float(np.hypot(*upright.size))
    return np.asarray(upright), focal35 / 43.27 * diagonal


def probe_video(path: Path) -> dict[str, Any]:
    """Return width and height as shown, duration (seconds) and rate (frames a second)."""
    command = ["ffprobe", "-v", "error", "-select_streams", "v:0", "-show_entries"]
    entries = (
        "stream=width,height,avg_frame_rate,duration:stream_side_data=rotation:format=duration"
    )
    text = toolkit.run_checked([*command, entries, "-of", "json", str(path)], "ffprobe")
    data = json.loads(text)
    if not data.get("streams"):
        raise toolkit.InputProblem(f"{path}: has no video stream")
    stream = data["streams"][0]
    turns = [abs(int(side.get("rotation", 0))) for side in stream.get("side_data_list", [])]
    size = (stream["width"], stream["height"])
    width, height = size[::-1] if any(turn % 180 == 90 for turn in turns) else size
    above, _, below = stream.get("avg_frame_rate", "0/1").partition("/")
    rate = float(above) / max(float(below or 1), 1)
    duration = float(stream.get("duration") or data.get("format", {}).get("duration") or 0)
    if duration <= 0 or rate <= 0:
        raise toolkit.InputProblem(f"{path}: states neither duration nor frame rate")
    return {"width": width, "height": height, "duration": duration, "rate": rate}


def video_windows(path: Path) -> Iterator[tuple[int, int, list[np.ndarray]]]:
    """Yield (number, count, candidate frames) of each window of a video; ffmpeg turns them."""
    facts = probe_video(path)
    count = int(np.clip(2 * facts["duration"], FEWEST_FRAMES, MOST_FRAMES))
    rate = min(facts["rate"], CANDIDATES * count / facts["duration"])
    per_window = max(1, round(rate * facts["duration"] / count))
    scale = min(1.0, SIDE / max(facts["width"], facts["height"]))
    width, height = (max(2, round(facts[key] * scale / 2) * 2) for key in ("width", "height"))
    command = ["ffmpeg", "-v", "error", "-i", str(path), "-vf"]
    command += [f"fps={rate:.6f},scale={width}:{height}:flags=area", "-pix_fmt", "rgb24"]
    with subprocess.Popen([*command, "-f", "rawvideo", "-"], stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        number, window = 0, []
        while len(data := child.stdout.read(width * height * 3)) == width * height * 3:
            window.append(np.frombuffer(data, np.uint8).reshape(height, width, 3))
            if len(window) == per_window:
                yield number, count, window
                number, window = number + 1, []
        if window:
            yield number, count, window


def pictures_of(source: Path) -> Iterator[tuple[int, int, str, np.ndarray, float]]:
    """Yield (done, total, name of the origin, pixels, EXIF focal length) of the source."""
    if is_video(source):
        toolkit.need_program("ffmpeg", "a video")
        for number, count, window in video_windows(source):
            grey = [cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in window]
            best = int(np.argmax([sharpness(picture) for picture in grey]))
            yield number + 1, max(count, number + 1), f"frame{number:04d}", window[best], 0.0
        return
    if not source.is_dir():
        raise toolkit.InputProblem(f"{source}: expected a folder of photographs or a video")
    paths = photographs_in(source)
    for number, path in enumerate(paths):
        pixels, focal = read_photograph(path)
        yield number + 1, len(paths), path.name, pixels, focal


class Copies:
    """Finds pictures that repeat an earlier one."""

    def __init__(self) -> None:
        """Start without pictures."""
        self.seen: list[np.ndarray] = []

    def add(self, picture: np.ndarray) -> bool:
        """Return True if the picture repeats an earlier one; else remember it."""
        small = small_grey(picture)
        if any(np.abs(small - other).mean() < COPY_LEVELS for other in self.seen):
            return True
        self.seen.append(small)
        return False


def file_name(origin: str, taken: set[str]) -> str:
    """Return a JPEG file name for a picture, unique among `taken`."""
    stem = Path(origin).stem
    name, number = stem, 1
    while name.lower() in taken:
        number += 1
        name = f"{stem}-{number}"
    taken.add(name.lower())
    return name + ".jpg"


def check_count(source: Path, frames: list[Frame], copies: int) -> None:
    """Raise InputProblem if too few different pictures remain."""
    if copies and not is_video(source):
        toolkit.note(
            f"{source}: {copies} of {copies + len(frames)} photographs are copies of others and "
            "are left out"
        )
    if len(frames) >= FEWEST:
        return
    if is_video(source):
        raise toolkit.InputProblem(
            f"{source}: the camera does not move: only {len(frames)} of {copies + len(frames)} "
            "frames differ; walk once around the object while filming"
        )
    raise toolkit.InputProblem(
        f"{source}: only {len(frames)} photographs differ, expected at least {FEWEST}; take 30 to "
        "60 from all sides of the object"
    )


def write_frames(source: Path, folder: Path) -> list[Frame]:
    """Write the pictures of the source into a folder, which appears when it is complete."""
    part = folder.with_name(folder.name + ".part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    frames: list[Frame] = []
    copies, copy_count, taken = Copies(), 0, set[str]()
    for done, total, origin, pixels, focal in pictures_of(source):
        toolkit.progress(done, total)
        if copies.add(pixels):
            copy_count += 1
            continue
        name = file_name(origin, taken)
        Image.fromarray(pixels).save(part / name, quality=QUALITY, subsampling=0)
        grey = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
        height, width = grey.shape
        frames.append(
            Frame(name, origin, width, height, sharpness(grey), float(grey.mean()), focal)
        )
    check_count(source, frames, copy_count)
    shutil.rmtree(folder, ignore_errors=True)
    part.rename(folder)
    return frames
