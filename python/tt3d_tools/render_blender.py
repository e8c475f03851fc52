"""Render views with Blender's Cycles on the CPU.

`render` starts Blender with this file as its script, and `inside_blender` then renders all views in
that one process. Blender has its own Python without our packages, so the part that runs there uses
only the standard library, numpy and Blender's modules.
"""

from __future__ import annotations

import math
import re
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))
import toolkit

import scene

START_SECONDS = 120  # for Blender's start and the import of the asset


def render(job: dict[str, Any], path: str) -> str:
    """Render the job in a Blender process; return Blender's version."""
    blender = toolkit.need_program("blender", "--renderer blender")
    limit = START_SECONDS + job["time_limit"] * len(job["views"])
    command = [blender, "-b", "--factory-startup", "-noaudio", "--python-exit-code", "9"]
    child = subprocess.Popen(
        [*command, "--python", __file__, "--", path],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
    )
    killer = threading.Timer(limit, child.kill)
    killer.start()
    start, lines = time.monotonic(), []
    for line in child.stdout:
        if line.startswith("@progress"):
            print(line, end="", flush=True)
        elif re.match(r"[\w.]*(Error|Exception)\b.*:", line):  # last line of a traceback
            lines.append(line.strip())
    child.wait()
    killer.cancel()
    if time.monotonic() - start >= limit:
        raise toolkit.ToolError(f"Blender did not finish within {limit:.0f} s and was ended")
    if child.returncode != 0:
        # Blender prints "Error: script failed" after the actual error.
        errors = [line for line in lines if "script failed" not in line] or ["no message"]
        raise toolkit.ToolError(f"Blender failed: {errors[-1]}")
    shown = subprocess.run([blender, "--version"], capture_output=True, text=True).stdout
    return shown.split()[1]


# ---- Inside Blender -----------------------------------------------------------------------


def import_asset(bpy: Any, path: str) -> None:
    """Import the asset as a user would: glTF with its own axes, OBJ as +Z up."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if path.lower().endswith(".glb"):
        bpy.ops.import_scene.gltf(filepath=path)
    elif hasattr(bpy.ops.wm, "obj_import"):
        bpy.ops.wm.obj_import(filepath=path, forward_axis="Y", up_axis="Z")
    else:
        bpy.ops.import_scene.obj(filepath=path, axis_forward="Y", axis_up="Z")
    if not any(o.type == "MESH" for o in bpy.data.objects):
        raise RuntimeError(f"tt3d: Blender found no mesh in {path}")


def base_color(material: Any) -> tuple[Any, tuple[float, ...]]:
    """Return the socket that provides a material's colour, or None and the colour itself."""
    nodes = material.node_tree.nodes if material.use_nodes else []
    for kind, name in (("BSDF_PRINCIPLED", "Base Color"), ("EMISSION", "Color")):
        for node in nodes:
            if node.type == kind:
                socket = node.inputs[name]
                link = socket.links[0].from_socket if socket.is_linked else None
                return link, tuple(socket.default_value)
    return None, tuple(material.diffuse_color)


def set_surface(material: Any, lit: bool) -> None:
    """Replace a material's surface by a matte or an emitting one of the same colour."""
    source, color = base_color(material)
    material.use_nodes = True
    tree = material.node_tree
    surface = tree.nodes.new("ShaderNodeBsdfDiffuse" if lit else "ShaderNodeEmission")
    if source is None:
        surface.inputs["Color"].default_value = color
    else:
        tree.links.new(source, surface.inputs["Color"])
    for node in [n for n in tree.nodes if n.type == "OUTPUT_MATERIAL"]:
        tree.nodes.remove(node)
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(surface.outputs[0], output.inputs["Surface"])


def add_ground(bpy: Any, job: dict[str, Any]) -> Any:
    """Add the matte disc below the object."""
    x, y, _ = job["centre"]
    bpy.ops.mesh.primitive_circle_add(
        vertices=128,
        radius=scene.GROUND_RADII * job["radius"],
        fill_type="NGON",
        location=(x, y, job["floor"]),
    )
    ground = bpy.context.object
    material = bpy.data.materials.new("ground")
    material.diffuse_color = (*[scene.GROUND_REFLECTANCE] * 3, 1)
    set_surface(material, lit=True)
    ground.data.materials.append(material)
    return ground


def add_light(bpy: Any) -> None:
    """Add the constant environment light and the sun."""
    world = bpy.data.worlds.new("world")
    world.use_nodes = True
    background = world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (1, 1, 1, 1)
    background.inputs["Strength"].default_value = scene.ENVIRONMENT_RADIANCE
    bpy.context.scene.world = world
    light = bpy.data.lights.new("sun", "SUN")
    light.energy = scene.SUN_IRRADIANCE
    light.angle = math.radians(2)
    sun = bpy.data.objects.new("sun", light)
    from mathutils import Vector

    sun.rotation_euler = Vector(scene.sun_direction()).to_track_quat("Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(sun)


def set_up(bpy: Any, job: dict[str, Any]) -> Any:
    """Set up Cycles on the CPU, plain sRGB output, a transparent film and our camera."""
    view = bpy.context.scene
    view.render.engine = "CYCLES"
    view.cycles.device = "CPU"
    view.cycles.samples = job["samples"]
    view.cycles.use_adaptive_sampling = False
    view.cycles.use_denoising = False  # Debian builds Blender without a denoiser
    view.cycles.pixel_filter_type = "BOX"
    view.cycles.max_bounces = 3 if job["lit"] else 0
    view.render.film_transparent = True
    view.render.use_persistent_data = True
    view.render.dither_intensity = 0
    view.view_settings.view_transform = "Standard"
    view.render.image_settings.file_format = "PNG"
    view.render.image_settings.color_mode = "RGBA"
    view.render.image_settings.compression = 15
    view.render.resolution_x, view.render.resolution_y = job["width"], job["height"]
    view.render.resolution_percentage = 100
    if job.get("motion_blur"):
        view.render.use_motion_blur = True
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    longer = max(job["width"], job["height"])
    camera.data.sensor_fit = "HORIZONTAL"
    camera.data.angle = 2 * math.atan(job["width"] / (2 * job["fx"]))
    camera.data.shift_x = (job["width"] / 2 - job["cx"]) / longer
    camera.data.shift_y = (job["cy"] - job["height"] / 2) / longer
    camera.data.clip_start, camera.data.clip_end = 1e-3 * job["radius"], 1e3 * job["radius"]
    view.collection.objects.link(camera)
    view.camera = camera
    return camera


def inside_blender(path: str) -> None:
    """Render all views of a job."""
    import bpy
    import numpy
    from mathutils import Matrix

    # Blender 3.4's glTF importer uses numpy.bool, which Debian's numpy no longer has.
    if not hasattr(numpy, "bool"):
        numpy.bool = bool
    job = toolkit.read_job(path)
    import_asset(bpy, job["asset"])
    for material in bpy.data.materials:
        set_surface(material, job["lit"])
    camera, ground = set_up(bpy, job), None
    if job["lit"]:
        add_light(bpy)
        ground = add_ground(bpy, job)
    for i, view in enumerate(job["views"]):
        m = view["camera_to_world"]
        camera.matrix_world = Matrix([m[4 * r : 4 * r + 4] for r in range(4)])
        if ground is not None:
            ground.hide_render = not scene.sees_ground(m, job["floor"], job["radius"])
        bpy.context.scene.render.filepath = view["file"]
        bpy.context.scene.cycles.seed = i
        bpy.ops.render.render(write_still=True)
        toolkit.progress(i + 1, len(job["views"]))


if __name__ == "__main__":
    inside_blender(sys.argv[sys.argv.index("--") + 1])
