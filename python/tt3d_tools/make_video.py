"""Encode pictures as an MP4 with ffmpeg, for tt3d render --video.

    python make_video.py PATTERN RATE BLUR CRF OUT.mp4

PATTERN is a file pattern of ffmpeg (frame%05d.png). BLUR pictures are averaged to one frame, as by
an open shutter. RATE is the rate of the output frames. CRF is the quality of H.264: at 18 the loss
is hardly visible, at 35 clearly.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
import toolkit


def work(arguments: list[str]) -> None:
    """Encode the pictures."""
    pattern, rate, blur, crf, out = arguments
    ffmpeg = toolkit.need_program("ffmpeg", "render --video")
    filters = f"tmix=frames={blur},select=not(mod(n+1\\,{blur}))," if int(blur) > 1 else ""
    command = [ffmpeg, "-v", "error", "-y", "-framerate", str(float(rate) * int(blur))]
    command += ["-i", pattern, "-vf", f"{filters}pad=ceil(iw/2)*2:ceil(ih/2)*2", "-r", rate]
    command += [
        "-c:v",
        "libx264",
        "-crf",
        crf,
        "-pix_fmt",
        "yuv420p",
        "-movflags",
        "+faststart",
        out,
    ]
    toolkit.run_checked(command, "encoding the video", 3600)


if __name__ == "__main__":
    toolkit.main(work)
