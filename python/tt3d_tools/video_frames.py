"""Sample frames of a video and cut them to the object.

    python video_frames.py JOB.json

The job has `video`, the number of `frames` to sample evenly, a `box` "LEFT,TOP,WIDTH,HEIGHT" or "",
a `mask` picture or "", `track` (follow the box of the first frame), a `folder` for the pictures,
and the JSON file `out`. ffmpeg decodes, applies the rotation that a phone wrote, and delivers one
frame at a time, at most 1280 pixels wide, so memory does not grow with the video's length or size.
Frames that are far apart are sought one by one, so time does not grow with the length either.
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

PICTURE_SIDE = 320  # pixels, longest side of the pictures for the victims
DECODED_SIDE = 1280  # pixels
TRACKING_RATE = 10  # frames a second for the tracker
SEEK_SECONDS = 4  # frames further apart are sought; a seek decodes from the last key frame


def shown_size(stream: dict[str, Any]) -> list[int]:
    """Return width and height of the upright frame with square pixels."""
    size = [int(stream["width"]), int(stream["height"])]
    across, _, down = stream.get("sample_aspect_ratio", "1:1").partition(":")
    if across.isdigit() and down.isdigit() and int(across) > 0 and int(down) > 0:
        size[0] = max(1, round(size[0] * int(across) / int(down)))
    turn = int(float(stream.get("tags", {}).get("rotate", 0)))
    for data in stream.get("side_data_list", []):
        turn = int(data.get("rotation", turn))
    if turn % 180 != 0:
        size.reverse()
    return size


def ratio(text: str) -> float:
    """Return the value of a fraction like "30000/1001"; 0 if it has none."""
    over, _, under = text.partition("/")
    return float(over) / float(under) if float(under or 0) else 0.0


def ask(ffprobe: str, video: str, *options: str) -> dict[str, Any]:
    """Return what ffprobe says about the first video stream that is not a cover picture."""
    command = [ffprobe, "-v", "error", "-select_streams", "V:0", "-of", "json", *options, video]
    found: dict[str, Any] = json.loads(toolkit.run_checked(command, f"{video}: reading it", 120))
    return found


def packet_times(ffprobe: str, video: str) -> tuple[list[float], int]:
    """Return the times at which frames are shown, in order, and the number of frames.

    A raw stream has frames without times.
    """
    packets = ask(ffprobe, video, "-show_entries", "packet=pts_time").get("packets", [])
    return sorted(float(p["pts_time"]) for p in packets if "pts_time" in p), len(packets)


def timing(ffprobe: str, video: str, found: dict[str, Any]) -> dict[str, float]:
    """Return duration and frame rate of the video stream, and its `lead`.

    The lead is the time in seconds by which the stream starts after the file. Matroska counts the
    duration from 0 even if the first frame is later. Files without a duration (WebM of a browser,
    raw H.264) are read to the end.
    """
    stream, container = found["stream"], found["format"]
    duration = float(stream.get("duration") or container.get("duration") or 0)
    rate = ratio(stream.get("avg_frame_rate", "0/1")) or ratio(stream.get("r_frame_rate", "0/1"))
    start, file_start = (float(x.get("start_time") or 0) for x in (stream, container))
    if "matroska" in container.get("format_name", ""):
        duration -= start
    if duration <= 0 or rate <= 0:
        times, count = packet_times(ffprobe, video)
        if len(times) > 1 and times[-1] > times[0]:
            # The last frame is shown as long as a frame in the mean.
            duration = (times[-1] - times[0]) * len(times) / (len(times) - 1)
            rate = len(times) / duration
        elif count > 0 and rate > 0:
            duration = count / rate
    return {"duration": duration, "rate": rate, "lead": max(0.0, start - file_start)}


def probe(video: str) -> dict[str, Any]:
    """Return upright size, duration in seconds, frame rate and lead of the first video stream."""
    ffprobe = toolkit.need_program("ffprobe", "video-score", "ffmpeg")
    found = ask(ffprobe, video, "-show_streams", "-show_format")
    if not found.get("streams"):
        raise toolkit.InputProblem(f"{video}: has no video stream")
    stream = found["streams"][0]
    facts = timing(ffprobe, video, {"stream": stream, "format": found.get("format", {})})
    if facts["duration"] <= 0 or facts["rate"] <= 0:
        raise toolkit.InputProblem(f"{video}: has no frames")
    width, height = shown_size(stream)
    return {"width": width, "height": height, **facts}


def ffmpeg_frames(
    video: str, before: list[str], after: list[str], width: int, height: int
) -> Iterator[np.ndarray]:
    """Yield frames [H,W,3] uint8; `before` and `after` are ffmpeg options around the input."""
    import numpy as np

    ffmpeg = toolkit.need_program("ffmpeg", "video-score")
    # Each decoding thread holds its own frames, which may be 4K.
    command = [ffmpeg, "-nostdin", "-v", "error", "-threads", "4", *before, "-i", video]
    command += ["-map", "0:V:0", *after]
    command += ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    size = width * height * 3
    # Errors go to a file: a broken video makes more of them than a pipe can hold.
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
    """Yield upright frames [H,W,3] uint8 at `rate` a second by decoding the whole video."""
    filters = f"fps={rate:.9f}:round=near,scale={width}:{height}:flags=area"
    yield from ffmpeg_frames(video, [], ["-vf", filters], width, height)


def seek(
    video: str, rate: float, lead: float, count: int, width: int, height: int
) -> Iterator[np.ndarray]:
    """Yield the same frames; each is found by a jump to the key frame before it."""
    only = ["-vf", f"scale={width}:{height}:flags=area", "-frames:v", "1"]
    for i in range(count):
        yield from ffmpeg_frames(video, ["-ss", f"{lead + i / rate:.6f}"], only, width, height)


def first_box(job: dict[str, Any], width: int, height: int) -> list[int]:
    """Return left, top, right and bottom in pixels of the upright video."""
    if job["mask"]:
        import numpy as np
        from PIL import Image

        try:
            light = np.asarray(Image.open(job["mask"]).convert("L")) > 127
        except OSError as error:
            raise toolkit.InputProblem(f"{job['mask']}: not a picture: {error}") from error
        if not light.any():
            raise toolkit.InputProblem(f"{job['mask']}: has no light pixels")
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
    """Track a box with OpenCV's CSRT."""

    def __init__(self, frame: np.ndarray, box: list[float]) -> None:
        """Start on the first frame."""
        cv2 = toolkit.need_package("cv2", "--track", "opencv-contrib-python-headless")
        self.cv2, self.box = cv2, box
        self.tracker = cv2.TrackerCSRT_create()
        left, top, right, bottom = (round(x) for x in box)
        self.tracker.init(
            cv2.cvtColor(frame, cv2.COLOR_RGB2BGR), (left, top, right - left, bottom - top)
        )

    def follow(self, frame: np.ndarray) -> list[float]:
        """Return the box in the next frame; if the tracker loses it, the last box."""
        found, rectangle = self.tracker.update(self.cv2.cvtColor(frame, self.cv2.COLOR_RGB2BGR))
        if found:
            left, top, wide, high = rectangle
            self.box = [left, top, left + wide, top + high]
        return self.box


def cut(frame: np.ndarray, box: list[float], path: Path) -> None:
    """Write the box of a frame, at most PICTURE_SIDE pixels a side."""
    from PIL import Image

    height, width = frame.shape[:2]
    left, top = max(0, math.floor(box[0])), max(0, math.floor(box[1]))
    right, bottom = min(width, math.ceil(box[2])), min(height, math.ceil(box[3]))
    if right - left < 2 or bottom - top < 2:
        left, top, right, bottom = 0, 0, width, height
    picture = Image.fromarray(frame[top:bottom, left:right])
    picture.thumbnail((PICTURE_SIDE, PICTURE_SIDE), Image.Resampling.BOX)
    picture.save(path)


def cut_frames(
    job: dict[str, Any], facts: dict[str, Any], size: tuple[int, int], rate: float, every: int
) -> list[dict[str, Any]]:
    """Write every `every`-th of the frames decoded at `rate`; return their places in the video."""
    width, height = size
    to_frame = (width / facts["width"], height / facts["height"]) * 2
    box = first_box(job, facts["width"], facts["height"])
    small = [x * s for x, s in zip(box, to_frame, strict=True)]
    if rate * SEEK_SECONDS < 1:
        pictures = seek(job["video"], rate, facts["lead"], job["frames"], width, height)
    else:
        pictures = decode(job["video"], rate, width, height)
    follower, frames = None, []
    for i, frame in enumerate(pictures):
        if job["track"] and follower is None:
            follower = Follower(frame, small)
        elif follower is not None:
            small = follower.follow(frame)
        if i % every != 0 or len(frames) >= job["frames"]:
            continue
        path = Path(job["folder"]) / f"frame{len(frames):05}.png"
        cut(frame, small, path)
        frames.append(
            {
                "file": str(path),
                "index": round(i / rate * facts["rate"]),
                "seconds": facts["lead"] + i / rate,
                "box": [round(x / s) for x, s in zip(small, to_frame, strict=True)],
            }
        )
        toolkit.progress(len(frames), job["frames"])
    return frames


def sample(job: dict[str, Any]) -> dict[str, Any]:
    """Write the sampled frames; return the content of the job's `out`."""
    facts = probe(job["video"])
    scale = min(1.0, DECODED_SIDE / max(facts["width"], facts["height"]))
    width, height = (max(2, round(facts[k] * scale / 2) * 2) for k in ("width", "height"))
    wanted_rate = job["frames"] / facts["duration"]
    rate = min(facts["rate"], max(wanted_rate, TRACKING_RATE) if job["track"] else wanted_rate)
    frames = cut_frames(job, facts, (width, height), rate, max(1, int(rate / wanted_rate)))
    if not frames:
        raise toolkit.InputProblem(f"{job['video']}: has no frames")
    expected = min(job["frames"], round(facts["duration"] * facts["rate"]))
    if len(frames) < 0.9 * expected:
        toolkit.note(
            f"{job['video']}: only {len(frames)} of {expected} frames could be decoded; "
            "the file may be truncated"
        )
    return {**facts, "frames": frames}


def work(arguments: list[str]) -> None:
    """Sample the video of a job."""
    (path,) = arguments
    job = toolkit.read_job(path)
    toolkit.need_package("numpy", "video-score")
    toolkit.need_package("PIL", "video-score", "pillow")
    Path(job["out"]).write_text(json.dumps(sample(job)))


if __name__ == "__main__":
    toolkit.main(work)
