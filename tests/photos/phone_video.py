"""Render a synthetic phone video with Blender: an object on a table in a room.

    blender -b -P tests/photos/phone_video.py -- OUT [FRAMES] [SAMPLES]

OUT gets frames/*.png, truth.json (cameras in OpenCV axes, world +Z up, pixels of the upright
picture), object.npz (vertices and triangles of the object) and video.mp4: H.264, portrait, stored
lying with rotation metadata, with hand-held shake, motion blur and changing exposure.
"""

import json
import math
import os
import subprocess
import sys

import bpy
import numpy as np
from mathutils import Euler, Matrix, Vector

WIDTH, HEIGHT = 540, 960
FOCAL = 0.95  # focal length over the picture's height


def textured(
    name: str, low: tuple, high: tuple, scale: float, detail: float = 2.0, voronoi: bool = False
) -> bpy.types.Material:
    """Return a material of a noise between two colours."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader = nodes["Principled BSDF"]
    shader.inputs["Roughness"].default_value = 0.8
    place = nodes.new("ShaderNodeTexCoord")
    noise = nodes.new("ShaderNodeTexVoronoi" if voronoi else "ShaderNodeTexNoise")
    noise.inputs["Scale"].default_value = scale
    if not voronoi:
        noise.inputs["Detail"].default_value = detail
    ramp = nodes.new("ShaderNodeValToRGB")
    ramp.color_ramp.elements[0].color, ramp.color_ramp.elements[1].color = low, high
    ramp.color_ramp.elements[0].position, ramp.color_ramp.elements[1].position = 0.35, 0.65
    links.new(place.outputs["Object"], noise.inputs["Vector"])
    links.new(noise.outputs["Distance" if voronoi else "Fac"], ramp.inputs["Fac"])
    links.new(ramp.outputs["Color"], shader.inputs["Base Color"])
    return material


def add_room() -> None:
    """Add table, floor, walls, some furniture and lamps."""
    bpy.ops.mesh.primitive_cube_add(size=1, location=(0, 0, -0.02))
    table = bpy.context.object
    table.scale = (1.4, 0.9, 0.04)
    table.data.materials.append(textured("wood", (0.25, 0.12, 0.05, 1), (0.5, 0.3, 0.15, 1), 9))
    bpy.ops.mesh.primitive_cube_add(size=1, location=(0, 0, 0.8))
    room = bpy.context.object
    room.scale = (6, 6, 3.2)
    room.data.materials.append(textured("wall", (0.5, 0.5, 0.45, 1), (0.8, 0.8, 0.75, 1), 4))
    random = np.random.default_rng(3)
    for i in range(14):
        angle = 2 * math.pi * i / 14
        bpy.ops.mesh.primitive_cube_add(
            size=1, location=(2.4 * math.cos(angle), 2.4 * math.sin(angle), random.uniform(-0.6, 1))
        )
        box = bpy.context.object
        box.scale = random.uniform(0.3, 0.8, 3)
        dark, light = random.uniform(0, 0.4, 3), random.uniform(0.3, 1, 3)
        box.data.materials.append(textured(f"box{i}", (*dark, 1), (*light, 1), 6))
    for place, power in (((1.5, 1, 1.9), 60), ((-1.5, -1, 1.9), 50), ((0.5, -1.6, 1.8), 40)):
        bpy.ops.object.light_add(type="AREA", location=place)
        bpy.context.object.data.energy = power
        bpy.context.object.data.size = 1.2
        direction = Vector((0, 0, 0)) - Vector(place)
        bpy.context.object.rotation_euler = direction.to_track_quat("-Z", "Y").to_euler()


def add_object() -> bpy.types.Object:
    """Add the object, standing on the table (z = 0)."""
    bpy.ops.mesh.primitive_monkey_add(size=0.26)
    thing = bpy.context.object
    bpy.ops.object.modifier_add(type="SUBSURF")
    thing.modifiers[0].levels = thing.modifiers[0].render_levels = 2
    bpy.ops.object.modifier_apply(modifier="Subdivision")
    bpy.ops.object.shade_smooth()
    thing.rotation_euler = (math.radians(-30), 0, 0.4)
    bpy.context.view_layer.update()
    lowest = min((thing.matrix_world @ v.co).z for v in thing.data.vertices)
    thing.location.z -= lowest + 0.004
    thing.data.materials.append(
        textured("skin", (0.75, 0.1, 0.05, 1), (0.95, 0.8, 0.2, 1), 28, detail=3)
    )
    bpy.context.view_layer.update()
    return thing


def camera_path(count: int) -> list[Matrix]:
    """Return camera matrices: a bit more than one round, rising, with shake."""
    random = np.random.default_rng(1)
    shake = random.normal(size=(count + 8, 6))
    kernel = np.ones(5) / 5
    shake = np.stack([np.convolve(shake[:, k], kernel, "same") for k in range(6)], 1)
    poses = []
    for i in range(count):
        t = i / count
        azimuth = 2 * math.pi * 2.1 * t
        elevation = math.radians(14 + 40 * t + 4 * math.sin(9 * t))
        distance = 0.72 + 0.05 * math.sin(5 * t)
        back = Vector(
            (
                math.cos(elevation) * math.cos(azimuth),
                math.cos(elevation) * math.sin(azimuth),
                math.sin(elevation),
            )
        )
        position = Vector((0, 0, 0.11)) + distance * back + 0.012 * Vector(shake[i, :3])
        look = (Vector((0, 0, 0.1)) - position).to_track_quat("-Z", "Y").to_matrix()
        wobble = Euler([0.02 * x for x in shake[i, 3:]]).to_matrix()
        poses.append(Matrix.Translation(position) @ (look @ wobble).to_4x4())
    return poses


def main() -> None:
    """Render all frames and encode them."""
    arguments = sys.argv[sys.argv.index("--") + 1 :]
    out = arguments[0]
    count = int(arguments[1]) if len(arguments) > 1 else 72
    samples = int(arguments[2]) if len(arguments) > 2 else 4
    os.makedirs(os.path.join(out, "frames"), exist_ok=True)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    add_room()
    thing = add_object()
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("world")
    scene.world.light_settings.use_ambient_occlusion = True
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.max_bounces = samples, 0
    scene.cycles.use_denoising = False
    scene.cycles.use_fast_gi, scene.cycles.fast_gi_method = True, "ADD"
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
    scene.render.resolution_percentage = 100
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 0.15
    scene.render.use_persistent_data = True
    scene.view_settings.view_transform = "Standard"
    bpy.ops.object.camera_add()
    camera = bpy.context.object
    camera.rotation_mode = "QUATERNION"
    scene.camera = camera
    camera.data.sensor_fit, camera.data.sensor_height = "VERTICAL", 24
    camera.data.lens = 24 * FOCAL
    poses = camera_path(count)
    last = None
    for i, pose in enumerate(poses):
        quaternion = pose.to_quaternion()
        if last is not None and quaternion.dot(last) < 0:
            quaternion.negate()
        last = quaternion
        camera.location, camera.rotation_quaternion = pose.to_translation(), quaternion
        camera.keyframe_insert("location", frame=i)
        camera.keyframe_insert("rotation_quaternion", frame=i)
    mesh = thing.data
    mesh.calc_loop_triangles()
    np.savez(
        os.path.join(out, "object.npz"),
        vertices=np.array([thing.matrix_world @ v.co for v in mesh.vertices]),
        triangles=np.array([t.vertices for t in mesh.loop_triangles]),
    )
    views = []
    for i, pose in enumerate(poses):
        flip = Matrix.Diagonal((1, -1, -1, 1))
        inverse = (pose @ flip).inverted()
        views.append({"frame": i, "world_to_camera": [list(row) for row in inverse]})
    truth = {"width": WIDTH, "height": HEIGHT, "focal": FOCAL * HEIGHT, "views": views}
    with open(os.path.join(out, "truth.json"), "w") as file:
        json.dump(truth, file)
    for i in range(count):
        path = os.path.join(out, "frames", f"{i:04d}.png")
        if os.path.exists(path):
            continue
        scene.frame_set(i)
        scene.view_settings.exposure = 0.35 * math.sin(2 * math.pi * 1.7 * i / count)
        scene.render.filepath = path
        bpy.ops.render.render(write_still=True)
    # A phone stores a portrait video lying, with the rotation as metadata.
    command = ["ffmpeg", "-v", "error", "-y", "-framerate", "12", "-i", f"{out}/frames/%04d.png"]
    command += ["-vf", "transpose=2", "-c:v", "libx264", "-crf", "20", "-pix_fmt", "yuv420p"]
    subprocess.run(
        [*command, "-metadata:s:v:0", "rotate=90", os.path.join(out, "video.mp4")], check=True
    )


main()
