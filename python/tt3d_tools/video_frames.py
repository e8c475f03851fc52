"""Samples frames of a video for tt3d, cut to the object.

    python video_frames.py JOB.json

The job names `video`, how many `frames` to sample evenly, a `box` "LEFT,TOP,WIDTH,HEIGHT" or "", a
`mask` picture or "", `track` (follow the box of the first frame), a `folder` for the pictures and
the JSON file `out`. ffmpeg decodes, obeys the rotation that a phone wrote, and hands over one frame
after the other at most 1280 pixels wide, so memory does not grow with length or size. Frames that
lie far apart are sought one by one, so time does not grow with length either.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parent))
import toolkit

if TYPE_CHECKING:
    import numpy as np

PICTURE_SIDE = 320  # pixels, of what the victims are shown
DECODED_SIDE = 1280  # pixels
TRACKING_RATE = 10  # frames a second that the tracker looks at
SEEK_SECONDS = 4  # frames further apart are sought; that decodes from the last key frame on


def probe(video: str) -> dict[str, Any]:
    """Upright size, duration in seconds and rate of the first video stream."""
    ffprobe = toolkit.need_program("ffprobe", "video-score", "ffmpeg")
    shown = toolkit.run_checked(
        [ffprobe, "-v", "error", "-of", "json", "-show_streams", "-show_format", video],
        f"{video}: reading it",
        120,
    )
    found = json.loads(shown)
    streams = [s for s in found.get("streams", []) if s.get("codec_type") == "video"]
    if not streams:
        raise toolkit.InputProblem(f"{video}: holds no video stream")
    stream = streams[0]
    turn = int(float(stream.get("tags", {}).get("rotate", 0)))
    for data in stream.get("side_data_list", []):
        turn = int(data.get("rotation", turn))
    size = [int(stream["width"]), int(stream["height"])]
    if turn % 180 != 0:
        size.reverse()
    duration = float(stream.get("duration") or found.get("format", {}).get("duration") or 0)
    over, under = (float(x) for x in stream.get("avg_frame_rate", "0/1").split("/"))
    rate = over / under if under else 0
    if duration <= 0 or rate <= 0:
        raise toolkit.InputProblem(f"{video}: a video without frames")
    return {"width": size[0], "height": size[1], "duration": duration, "rate": rate}


def ffmpeg_frames(
    video: str, before: list[str], after: list[str], width: int, height: int
) -> Iterator[np.ndarray]:
    """Frames [H,W,3] uint8 of the first video stream; options go before and after the input."""
    import numpy as np

    ffmpeg = toolkit.need_program("ffmpeg", "video-score")
    # Each decoding thread holds frames of its own, 4K ones if need be.
    command = [ffmpeg, "-nostdin", "-v", "error", "-threads", "4", *before, "-i", video]
    command += ["-map", "0:v:0", *after]
    command += ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    size = width * height * 3
    # Its errors go to a file: a broken video has more of them than a pipe holds.
    with tempfile.TemporaryFile() as errors:
        child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors)
        try:
            while len(data := child.stdout.read(size)) == size:
                yield np.frombuffer(data, np.uint8).reshape(height, width, 3)
            if child.wait() != 0:
                errors.seek(0)
                lines = errors.read().decode(errors="replace").strip().splitlines()
                raise toolkit.InputProblem(
                    f"{video}: {lines[-1] if lines else 'cannot be decoded'}"
                )
        finally:
            child.kill()
            child.wait()


def decode(video: str, rate: float, width: int, height: int) -> Iterator[np.ndarray]:
    """Upright frames [H,W,3] uint8 at `rate` a second, one after the other."""
    filters = f"fps={rate:.9f}:round=near,scale={width}:{height}:flags=area"
    yield from ffmpeg_frames(video, [], ["-vf", filters], width, height)


def seek(video: str, rate: float, count: int, width: int, height: int) -> Iterator[np.ndarray]:
    """The same frames, each found by a jump to the key frame before it."""
    only = ["-vf", f"scale={width}:{height}:flags=area", "-frames:v", "1"]
    for i in range(count):
        yield from ffmpeg_frames(video, ["-ss", f"{i / rate:.6f}"], only, width, height)


def first_box(job: dict[str, Any], width: int, height: int) -> list[int]:
    """Left, top, right, bottom in pixels of the upright video."""
    if job["mask"]:
        import numpy as np
        from PIL import Image

        try:
            light = np.asarray(Image.open(job["mask"]).convert("L")) > 127
        except OSError as error:
            raise toolkit.InputProblem(f"{job['mask']}: no picture: {error}") from error
        if not light.any():
            raise toolkit.InputProblem(f"{job['mask']}: no light pixels to put a box around")
        rows, columns = np.flatnonzero(light.any(1)), np.flatnonzero(light.any(0))
        across, down = width / light.shape[1], height / light.shape[0]
        return [
            int(columns[0] * across),
            int(rows[0] * down),
            math.ceil((columns[-1] + 1) * across),
            math.ceil((rows[-1] + 1) * down),
        ]
    if not job["box"]:
        return [0, 0, width, height]
    try:
        left, top, wide, high = (int(word) for word in job["box"].split(","))
    except ValueError as error:
        raise toolkit.InputProblem(
            f"--box {job['box']}: expected LEFT,TOP,WIDTH,HEIGHT in pixels"
        ) from error
    box = [left, top, left + wide, top + high]
    if min(box) < 0 or wide < 8 or high < 8 or box[2] > width or box[3] > height:
        raise toolkit.InputProblem(
            f"--box {job['box']}: not within the upright frame of {width} x {height} pixels, "
            "or smaller than 8 pixels"
        )
    return box


class Follower:
    """OpenCV's CSRT tracker."""

    def __init__(self, frame: np.ndarray, box: list[float]) -> None:
        """Starts on the first frame."""
        cv2 = toolkit.need_package("cv2", "--track", "opencv-contrib-python-headless")
        self.cv2, self.box = cv2, box
        self.tracker = cv2.TrackerCSRT_create()
        left, top, right, bottom = (round(x) for x in box)
        self.tracker.init(
            cv2.cvtColor(frame, cv2.COLOR_RGB2BGR), (left, top, right - left, bottom - top)
        )

    def follow(self, frame: np.ndarray) -> list[float]:
        """The box in the next frame; where it is lost, the last one."""
        found, rectangle = self.tracker.update(self.cv2.cvtColor(frame, self.cv2.COLOR_RGB2BGR))
        if found:
            left, top, wide, high = rectangle
            self.box = [left, top, left + wide, top + high]
        return self.box


def cut(frame: np.ndarray, box: list[float], path: Path) -> None:
    """Writes the box of a frame, at most PICTURE_SIDE pixels a side."""
    from PIL import Image

    height, width = frame.shape[:2]
    left, top = max(0, math.floor(box[0])), max(0, math.floor(box[1]))
    right, bottom = min(width, math.ceil(box[2])), min(height, math.ceil(box[3]))
    if right - left < 2 or bottom - top < 2:
        left, top, right, bottom = 0, 0, width, height
    picture = Image.fromarray(frame[top:bottom, left:right])
    picture.thumbnail((PICTURE_SIDE, PICTURE_SIDE), Image.Resampling.BOX)
    picture.save(path)


def sample(job: dict[str, Any]) -> dict[str, Any]:
    """Writes the sampled frames; what the job's `out` gets."""
    facts = probe(job["video"])
    scale = min(1.0, DECODED_SIDE / max(facts["width"], facts["height"]))
    width, height = (max(2, round(facts[k] * scale / 2) * 2) for k in ("width", "height"))
    box = first_box(job, facts["width"], facts["height"])
    small = [
        x * s
        for x, s in zip(box, (width / facts["width"], height / facts["height"]) * 2, strict=True)
    ]
    wanted_rate = job["frames"] / facts["duration"]
    rate = min(facts["rate"], max(wanted_rate, TRACKING_RATE) if job["track"] else wanted_rate)
    every = max(1, int(rate / wanted_rate))
    follower, frames = None, []
    if rate * SEEK_SECONDS < 1:
        pictures = seek(job["video"], rate, job["frames"], width, height)
    else:
        pictures = decode(job["video"], rate, width, height)
    for i, frame in enumerate(pictures):
        if job["track"]:
            if follower is None:
                follower = Follower(frame, small)
            else:
                small = follower.follow(frame)
        if i % every == 0 and len(frames) < job["frames"]:
            path = Path(job["folder"]) / f"frame{len(frames):05}.png"
            cut(frame, small, path)
            back = [facts["width"] / width, facts["height"] / height] * 2
            frames.append(
                {
                    "file": str(path),
                    "index": round(i / rate * facts["rate"]),
                    "seconds": i / rate,
                    "box": [round(x * s) for x, s in zip(small, back, strict=True)],
                }
            )
            toolkit.progress(len(frames), job["frames"])
    if not frames:
        raise toolkit.InputProblem(f"{job['video']}: a video without frames")
    expected = min(job["frames"], round(facts["duration"] * facts["rate"]))
    if len(frames) < 0.9 * expected:
        toolkit.note(
            f"{job['video']}: only {len(frames)} of {expected} frames could be decoded; "
            "the file may be cut"
        )
    return {**facts, "frames": frames}


def work(arguments: list[str]) -> None:
    """Samples the video of a job."""
    (path,) = arguments
    job = toolkit.read_job(path)
    toolkit.need_package("numpy", "video-score")
    toolkit.need_package("PIL", "video-score", "pillow")
    Path(job["out"]).write_text(json.dumps(sample(job)))


if __name__ == "__main__":
    toolkit.main(work)
