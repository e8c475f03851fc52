"""Renders an asset from a set of cameras with Mitsuba, Blender or MeshLab, for tt3d.

    python render_views.py JOB.json

The job names `renderer`, `asset` (GLB or OBJ; OBJ alone for Mitsuba and MeshLab), `lit`, `width`,
`height`, `fx`, `cx`, `cy`, `samples`, the object's `centre`, `radius` and `floor` (its lowest z), a
`work` folder, `time_limit` in seconds a view and `views`: camera_to_world (16 numbers, row-major,
OpenGL camera, +Z up world) and the PNG file (8 bit RGBA, straight alpha) to write. `version_file`
receives the renderer's version.

Unlit pictures show the texture as it is. Lit ones have an environment of constant light, a sun and
a matte ground disc below the object, wherever the camera is above it; MeshLab has its headlight.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
import toolkit


def work(arguments: list[str]) -> None:
    """Hands the job to the renderer it names."""
    (path,) = arguments
    job = toolkit.read_job(path)
    if job["renderer"] == "mitsuba":
        import render_mitsuba as renderer
    elif job["renderer"] == "blender":
        import render_blender as renderer
    elif job["renderer"] == "meshlab":
        import render_meshlab as renderer
    else:
        raise toolkit.InputProblem(f"renderer {job['renderer']}: mitsuba, blender or meshlab")
    version = renderer.render(job, path)
    Path(job["version_file"]).write_text(version)


if __name__ == "__main__":
    toolkit.main(work)
