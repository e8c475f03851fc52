"""Render an asset from a list of cameras with Mitsuba, Blender or MeshLab.

    python render_views.py JOB.json

The job has `renderer`, `asset` (GLB or OBJ; only OBJ for Mitsuba and MeshLab), `lit`, `width`,
`height`, `fx`, `cx`, `cy`, `samples`, the object's `centre`, `radius` and `floor` (its lowest z), a
`work` folder, `time_limit` in seconds a view, and `views`. A view has camera_to_world (16 numbers,
row-major, OpenGL camera, +Z up world) and the PNG file to write (8 bit RGBA, straight alpha). The
renderer's version is written to `version_file`.

Unlit pictures show the texture as it is. Lit pictures have constant environment light, a sun, and a
matte ground disc below the object if the camera is above it. MeshLab uses its headlight instead.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
import toolkit


def work(arguments: list[str]) -> None:
    """Run the job with the renderer that it names."""
    (path,) = arguments
    job = toolkit.read_job(path)
    if job["renderer"] == "mitsuba":
        import render_mitsuba as renderer
    elif job["renderer"] == "blender":
        import render_blender as renderer
    elif job["renderer"] == "meshlab":
        import render_meshlab as renderer
    else:
        raise toolkit.InputProblem(
            f"renderer {job['renderer']}: expected mitsuba, blender or meshlab"
        )
    version = renderer.render(job, path)
    Path(job["version_file"]).write_text(version)


if __name__ == "__main__":
    toolkit.main(work)
