"""Render views with MeshLab, driven through its window under Xvfb by keyboard.

Each camera is pasted through the clipboard, and the picture is saved as a snapshot. Debian's
MeshLab 2020.09 ends with a failed assertion on every OBJ file, so it gets a PLY. We write the PLY
ourselves, because trimesh cannot write texture coordinates at the corners or name the texture, and
MeshLab needs both. A project file has the rendering options. Lit views from above the ground have
the ground as a second layer. MeshLab casts no shadows. See
docs/decisions/0012-meshlab-by-keyboard.md.
"""

from __future__ import annotations

import os
import re
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import toolkit

import scene

# MeshLab's codes in a project file for textured triangles and vertex colours; True: lit per vertex.
OPTIONS = {
    False: "100001010000000000000000000001010010010010100000000100111010100000001101",
    True: "100001010000000000000000000001011010010010100000000100111010100000001001",
}
PROJECT = """<!DOCTYPE MeshLabDocument>
<MeshLabProject>
 <MeshGroup>
{layers} </MeshGroup>
 <RasterGroup/>
</MeshLabProject>
"""
LAYER = """  <MLMesh label="{name}" filename="{name}.ply" visible="1">
   <MLMatrix44>
{matrix}</MLMatrix44>
   <RenderingOption boxColor="234 234 234 255" solidColor="255 255 255 255" pointSize="3" \
wireColor="64 64 64 255" pointColor="131 149 69 255" wireWidth="1">{options}</RenderingOption>
  </MLMesh>
"""
# MeshLab crashes on rows that do not end in a space.
IDENTITY = "1 0 0 0 \n0 1 0 0 \n0 0 1 0 \n0 0 0 1 \n"
VIEW = """<!DOCTYPE ViewState>
<project>
 <VCGCamera TranslationVector="{translation} 1" LensDistortion="0 0" ViewportPx="{size} {size}"
  PixelSizeMm="{pixel} {pixel}" CenterPx="{centre} {centre}" FocalMm="{focal}"
  RotationMatrix="{rotation} " CameraType="0" BinaryData="0"/>
 <ViewSettings NearPlane="{near}" FarPlane="{far}" TrackScale="1"/>
</project>
"""
PIXEL_MM = 0.03
GROUND_CORNERS = 64
FRAME_ROWS = 104  # rows of MeshLab's window outside the drawing
MAX_ROWS = 1200  # of the drawing
START_SECONDS = float(os.environ.get("TT3D_MESHLAB_START", "90"))
DIALOG_PATIENCE = (6, 12)  # seconds; after each of them the keys are sent again
STEP_SECONDS = 20  # limit for one dialog or one file; after it MeshLab counts as hanging


def wait_for(condition: Callable[[], Any], seconds: float, what: str) -> Any:
    """Poll until the condition holds; raise ToolError after `seconds`."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        time.sleep(0.03)
    raise toolkit.ToolError(f"MeshLab hangs: no {what} after {seconds:.0f} s; it was ended")


def read_obj(path: Path) -> tuple[Any, Any, Any, Any]:
    """Read a triangle OBJ: positions, uvs and the two index arrays.

    trimesh splits vertices at seams of the uvs. Vertices at the same position are merged again,
    because MeshLab computes the normals of lit views from shared vertices.
    """
    import numpy as np
    import trimesh

    mesh = trimesh.load(path, force="mesh", process=False, skip_materials=True)
    vertices, index = np.unique(np.asarray(mesh.vertices, "<f4"), axis=0, return_inverse=True)
    faces = index.reshape(-1)[mesh.faces]
    uvs = np.asarray(mesh.visual.uv, "<f4")
    return vertices, uvs, faces.astype("<i4"), np.asarray(mesh.faces, "<i4")


def write_ply(mesh: tuple[Any, Any, Any, Any], path: Path, texture: str) -> None:
    """Write a PLY with texture coordinates at the corners.

    The vertices are white, because MeshLab multiplies their colour with the texture.
    """
    import numpy as np

    vertices, uvs, faces, uv_faces = mesh
    points = np.zeros(len(vertices), dtype=[("p", "<f4", 3), ("c", "u1", 4)])
    points["p"], points["c"] = vertices, 255
    kind = [("n", "u1"), ("i", "<i4", 3), ("m", "u1"), ("t", "<f4", 6)]
    corners = np.zeros(len(faces), dtype=kind)
    corners["n"], corners["i"], corners["m"] = 3, faces, 6
    corners["t"] = uvs[uv_faces].reshape(-1, 6)
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment TextureFile {texture}",
        f"element vertex {len(vertices)}",
        *[f"property float {axis}" for axis in "xyz"],
        *[f"property uchar {channel}" for channel in ("red", "green", "blue", "alpha")],
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "property list uchar float texcoord",
        "end_header\n",
    ]
    path.write_bytes("\n".join(header).encode() + points.tobytes() + corners.tobytes())


def write_ground(job: dict[str, Any], folder: Path) -> None:
    """Write the ground disc as ground.ply, with a plain grey picture as its texture."""
    import numpy as np
    from PIL import Image

    angle = 2 * np.pi * np.arange(GROUND_CORNERS) / GROUND_CORNERS
    radius, (x, y, _) = scene.GROUND_RADII * job["radius"], job["centre"]
    rim = np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle)], 1)
    vertices = np.full((GROUND_CORNERS + 1, 3), job["floor"], "<f4")
    vertices[:-1, :2], vertices[-1, :2] = rim, (x, y)
    corner = np.arange(GROUND_CORNERS)
    faces = np.stack([corner, (corner + 1) % GROUND_CORNERS, 0 * corner + GROUND_CORNERS], 1)
    uvs = np.full((1, 2), 0.5, "<f4")
    write_ply((vertices, uvs, faces.astype("<i4"), 0 * faces), folder / "ground.ply", "ground.png")
    grey = round(255 * (1.055 * scene.GROUND_REFLECTANCE ** (1 / 2.4) - 0.055))
    Image.new("RGB", (4, 4), (grey,) * 3).save(folder / "ground.png")


def write_scene(job: dict[str, Any], texture: Path, folder: Path, with_ground: bool) -> None:
    """Write the project and its layers."""
    folder.mkdir()
    os.symlink(texture, folder / f"texture{texture.suffix}")
    write_ply(read_obj(Path(job["asset"])), folder / "object.ply", f"texture{texture.suffix}")
    names = ["object"]
    if with_ground:
        write_ground(job, folder)
        names.append("ground")
    options = OPTIONS[bool(job["lit"])]
    layers = "".join(LAYER.format(name=n, matrix=IDENTITY, options=options) for n in names)
    (folder / "object.mlp").write_text(PROJECT.format(layers=layers))


def view_state(job: dict[str, Any], camera_to_world: list[float], rows: int) -> str:
    """Return a camera in MeshLab's format: the camera's axes as rows, its negated position."""
    import numpy as np

    matrix = np.array(camera_to_world).reshape(4, 4)
    rotation = np.eye(4)
    rotation[:3, :3] = matrix[:3, :3].T
    numbers = lambda values: " ".join(f"{v:.9g}" for v in values)  # noqa: E731
    return VIEW.format(
        translation=numbers(-matrix[:3, 3]),
        rotation=numbers(rotation.flatten()),
        size=rows,
        centre=rows // 2,
        pixel=PIXEL_MM,
        focal=job["fx"] * PIXEL_MM * rows / job["height"],
        near=1e-2 * job["radius"],
        far=1e2 * job["radius"],
    )


class Window:
    """MeshLab on its own display."""

    def __init__(self, folder: Path, rows: int, layers: int) -> None:
        """Start the display, and MeshLab with folder/object.mlp, which has `layers` meshes."""
        self.folder, self.taken, self.last = folder, 0, b""
        self.display = subprocess.Popen(
            ["Xvfb", "-displayfd", "1", "-screen", "0", "1800x1400x24", "+extension", "GLX"],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        number = self.display.stdout.readline().decode().strip()
        if not number:
            raise toolkit.ToolError("Xvfb did not start")
        home = folder / "home"
        home.mkdir(mode=0o700, exist_ok=True)
        self.env = {
            **os.environ,
            "DISPLAY": f":{number}",
            "LIBGL_ALWAYS_SOFTWARE": "1",
            "HOME": str(home),
            "XDG_CONFIG_HOME": str(home),
            "XDG_RUNTIME_DIR": str(home),
            "LC_ALL": "C",
        }
        self.log = folder / "meshlab.log"
        self.program = subprocess.Popen(
            ["meshlab", str(folder / "object.mlp")],
            cwd=folder,
            env=self.env,
            stdout=self.log.open("wb"),
            stderr=subprocess.STDOUT,
        )
        self.name = wait_for(lambda: self.find("MeshLab.*mlp"), START_SECONDS, "window")
        wait_for(
            lambda: self.log.read_text(errors="replace").count("Opened mesh") >= layers,
            START_SECONDS,
            "mesh",
        )
        self.xdotool("windowsize", "--sync", self.name, "1700", str(rows + FRAME_ROWS))
        self.xdotool("windowfocus", self.name)
        time.sleep(1)

    def logged(self, text: str) -> bool:
        """Return whether the text is in MeshLab's log."""
        return text in self.log.read_text(errors="replace")

    def close(self) -> None:
        """End both processes; the display is asked to exit, so that it frees its number."""
        program = getattr(self, "program", None)
        if program is not None and program.poll() is None:
            program.kill()
            program.wait()
        self.display.terminate()
        try:
            self.display.wait(5)
        except subprocess.TimeoutExpired:
            self.display.kill()
            self.display.wait()

    def find(self, title: str) -> str | None:
        """Return the window with this title or None; raise ToolError if MeshLab has ended."""
        if self.program.poll() is not None:
            lines = self.log.read_text(errors="replace").strip().splitlines() or ["no message"]
            raise toolkit.ToolError(f"MeshLab ended: {lines[-1]}")
        found = subprocess.run(
            ["xdotool", "search", "--onlyvisible", "--name", title],
            env=self.env,
            capture_output=True,
            text=True,
            timeout=STEP_SECONDS,
        ).stdout.split()
        return found[0] if found else None

    def xdotool(self, *words: str) -> None:
        """Run xdotool, which moves and focuses windows and types keys."""
        subprocess.run(["xdotool", *words], env=self.env, check=True, timeout=STEP_SECONDS)

    def menu(self, menu: str, *keys: str) -> None:
        """Choose an entry of a menu by its keys."""
        self.xdotool("windowfocus", self.name)
        self.xdotool("key", menu)
        time.sleep(0.15)
        self.xdotool("key", "--delay", "30", *keys)

    def open_dialog(self, title: str, menu: str, *keys: str) -> None:
        """Open a menu's dialog; send the keys again if a busy machine has lost them."""
        for patience in (*DIALOG_PATIENCE, None):
            self.menu(menu, *keys)
            try:
                wait_for(lambda: self.find(title), patience or STEP_SECONDS, f"dialog {title}")
                return
            except toolkit.ToolError:
                if patience is None or self.program.poll() is not None:
                    raise
                self.xdotool("key", "Escape")

    def set_camera(self, state: str) -> None:
        """Choose Windows > Paste clipboard to camera settings, the second entry from the end."""
        subprocess.run(
            ["xclip", "-selection", "clipboard"],
            env=self.env,
            input=state.encode(),
            check=True,
            stderr=subprocess.DEVNULL,
        )
        self.menu("alt+w", "Up", "Up", "Return")
        time.sleep(0.25)

    def snapshot(self) -> Path:
        """Choose File > Save snapshot; the first time, set the background to transparent."""
        picture = self.folder / f"snapshot{self.taken:02}.png"
        self.open_dialog("Save snapshot", "alt+f", "t")
        time.sleep(0.1)
        if self.taken == 0:
            self.xdotool("key", "--delay", "30", *["Tab"] * 6, "Down")
        self.xdotool("key", "Return")
        self.taken += 1
        name = f"Snapshot saved to ./{picture.name}"
        wait_for(lambda: self.logged(name), STEP_SECONDS, picture.name)
        return picture

    def snapshot_from(self, state: str) -> Path:
        """Take the snapshot of a camera; repeat it if it is the same as the last one."""
        for _ in range(2):
            self.set_camera(state)
            picture = self.snapshot()
            shown = picture.read_bytes()
            if shown != self.last:
                break
        self.last = shown
        return picture


def resample(source: Path, target: str, job: dict[str, Any]) -> None:
    """Crop the middle of the drawing and area-average it to the job's size, premultiplied."""
    import numpy as np
    from PIL import Image

    picture = np.asarray(Image.open(source).convert("RGBA"), np.float32) / 255
    rows, columns = picture.shape[:2]
    wide = round(rows * job["width"] / job["height"])
    left = (columns - wide) // 2
    if left < 0:
        raise toolkit.InputProblem("--renderer meshlab: pictures must not be wider than 1.2:1")
    picture = picture[:, left : left + wide]
    picture[..., :3] *= picture[..., 3:]
    size = (job["width"], job["height"])
    planes = [
        np.asarray(Image.fromarray(picture[..., k]).resize(size, Image.Resampling.BOX))
        for k in range(4)
    ]
    alpha = planes[3][..., None]
    color = np.stack(planes[:3], axis=2) / np.maximum(alpha, 1e-6)
    rgba = np.concatenate([np.clip(color, 0, 1), alpha], axis=2)
    Image.fromarray(np.round(rgba * 255).astype(np.uint8), "RGBA").save(target)


def take_views(job: dict[str, Any], views: list[Any], folder: Path, layers: int) -> Iterator[None]:
    """Save the views of a folder's project in one window; yield after each view."""
    rows = job["height"] * max(1, MAX_ROWS // job["height"])
    window = None
    try:
        window = Window(folder, rows, layers)
        for view in views:
            picture = window.snapshot_from(view_state(job, view["camera_to_world"], rows))
            resample(picture, view["file"], job)
            picture.unlink()
            yield
    finally:
        if window is not None:
            window.close()


def version(meshlab: str) -> str:
    """Return the version of Debian's package, because the program does not print it."""
    shown = subprocess.run(
        ["dpkg-query", "-W", "-f=${Version}", "meshlab"], capture_output=True, text=True
    ).stdout
    found = re.match(r"\d+\.\d+", shown)
    return found.group(0) if found else Path(meshlab).name


def render(job: dict[str, Any], path: str) -> str:
    """Render the job in one window, or in two if only some views have the ground.

    Return MeshLab's version.
    """
    purpose = "--renderer meshlab"
    meshlab = toolkit.need_program("meshlab", purpose)
    toolkit.need_program("Xvfb", purpose, "xvfb")
    toolkit.need_program("xdotool", purpose)
    toolkit.need_program("xclip", purpose)
    toolkit.need_package("trimesh", purpose)
    if job["height"] > MAX_ROWS:
        raise toolkit.InputProblem(f"{purpose}: pictures have at most {MAX_ROWS} rows")
    from render_mitsuba import texture_of

    obj = Path(job["asset"])
    texture = texture_of(obj)
    if texture is None:
        raise toolkit.InputProblem(f"{obj}: {purpose} needs a texture")
    groups: dict[bool, list[Any]] = {}
    for view in job["views"]:
        matrix = view["camera_to_world"]
        ground = bool(job["lit"]) and scene.sees_ground(matrix, job["floor"], job["radius"])
        groups.setdefault(ground, []).append(view)
    done = 0
    for with_ground, views in groups.items():
        folder = Path(job["work"]) / ("ground" if with_ground else "plain")
        write_scene(job, texture, folder, with_ground)
        for _ in take_views(job, views, folder, 1 + with_ground):
            done += 1
            toolkit.progress(done, len(job["views"]))
    return version(meshlab)
