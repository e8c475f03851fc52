"""Render views with Mitsuba 3: OBJ and its texture, path tracing."""

from __future__ import annotations

import glob
import math
import os
import re
from pathlib import Path
from typing import Any

import toolkit

import scene

MINIMUM_LLVM = 17  # older versions cannot lower llvm.minimum for AVX-512 and end the process


def newest_llvm() -> str | None:
    """Return the newest LLVM library that Mitsuba's vectorised variants can use."""
    found = []
    for pattern in ("/usr/lib/*/libLLVM*.so*", "/usr/lib/llvm-*/lib/libLLVM*.so*"):
        for path in glob.glob(pattern):
            version = re.search(r"libLLVM(?:-|\.so\.)(\d+)", path)
            if version and int(version.group(1)) >= MINIMUM_LLVM:
                found.append((int(version.group(1)), path))
    return max(found)[1] if found else None


def load_mitsuba() -> Any:
    """Import Mitsuba with the fastest variant that works on this machine."""
    library = os.environ.get("DRJIT_LIBLLVM_PATH") or newest_llvm()
    if library:
        os.environ["DRJIT_LIBLLVM_PATH"] = library
    mitsuba = toolkit.need_package("mitsuba", "--renderer mitsuba")
    mitsuba.set_variant("llvm_ad_rgb" if library else "scalar_rgb")
    return mitsuba


def texture_of(obj: Path) -> Path | None:
    """Return the picture that the OBJ's material names; Mitsuba does not read MTL files."""
    library = re.search(r"^mtllib\s+(.+)$", obj.read_text(errors="replace"), re.M)
    if not library:
        return None
    path = obj.parent / library.group(1).strip()
    if not path.exists():
        raise toolkit.InputProblem(f"{obj}: its material file {path.name} does not exist")
    picture = re.search(r"^\s*map_Kd\s+(.+)$", path.read_text(errors="replace"), re.M)
    return obj.parent / picture.group(1).strip() if picture else None


def scene_of(job: dict[str, Any], with_ground: bool) -> dict[str, Any]:
    """Return the scene without a sensor."""
    picture = texture_of(Path(job["asset"]))
    color: dict[str, Any] = {"type": "rgb", "value": 0.5}
    if picture is not None:
        if not picture.exists():
            raise toolkit.InputProblem(f"{job['asset']}: its texture {picture} does not exist")
        color = {"type": "bitmap", "filename": str(picture), "wrap_mode": "clamp"}
    shape: dict[str, Any] = {"type": "obj", "filename": job["asset"]}
    parts: dict[str, Any] = {"type": "scene", "object": shape}
    if not job["lit"]:
        shape["bsdf"] = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
        shape["emitter"] = {"type": "area", "radiance": color}
        return {**parts, "integrator": {"type": "path", "max_depth": 1}}
    shape["bsdf"] = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": color}}
    parts["integrator"] = {"type": "path", "max_depth": 4, "hide_emitters": True}
    parts["sky"] = {"type": "constant", "radiance": scene.ENVIRONMENT_RADIANCE}
    parts["sun"] = {
        "type": "directional",
        "direction": [-x for x in scene.sun_direction()],
        "irradiance": scene.SUN_IRRADIANCE,
    }
    if with_ground:
        parts["ground"] = ground_of(job)
    return parts


def ground_of(job: dict[str, Any]) -> dict[str, Any]:
    """Return the matte disc below the object."""
    from mitsuba import ScalarTransform4f as Transform

    x, y, _ = job["centre"]
    place = Transform().translate([x, y, job["floor"]])
    return {
        "type": "disk",
        "to_world": place @ Transform().scale(scene.GROUND_RADII * job["radius"]),
        "bsdf": {
            "type": "diffuse",
            "reflectance": {"type": "rgb", "value": scene.GROUND_REFLECTANCE},
        },
    }


def sensor_of(job: dict[str, Any], camera_to_world: list[float]) -> dict[str, Any]:
    """Return a sensor. Mitsuba's camera looks along +z with x to the left, unlike OpenGL's."""
    import numpy as np
    from mitsuba import ScalarTransform4f as Transform

    matrix = np.array(camera_to_world).reshape(4, 4) @ np.diag([-1.0, 1.0, -1.0, 1.0])
    width, height = job["width"], job["height"]
    return {
        "type": "perspective",
        "fov": 2 * math.degrees(math.atan(width / (2 * job["fx"]))),
        "fov_axis": "x",
        "principal_point_offset_x": job["cx"] / width - 0.5,
        "principal_point_offset_y": job["cy"] / height - 0.5,
        "near_clip": 1e-3 * job["radius"],
        "far_clip": 1e3 * job["radius"],
        "to_world": Transform(matrix),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "pixel_format": "rgba",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "multijitter", "sample_count": job["samples"]},
    }


def write_png(mitsuba: Any, pixels: Any, path: str) -> None:
    """Write linear premultiplied RGBA as 8 bit sRGB with straight alpha."""
    import numpy as np
    from PIL import Image

    rgba = np.array(pixels, dtype=np.float64)
    alpha = np.clip(rgba[..., 3:], 0, 1)
    linear = np.clip(rgba[..., :3] / np.maximum(alpha, 1e-6), 0, 1)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    bytes_ = np.round(255 * np.concatenate([srgb, alpha], axis=2)).astype(np.uint8)
    Image.fromarray(bytes_, "RGBA").save(path)


def render(job: dict[str, Any], path: str) -> str:
    """Render the job in this process; return Mitsuba's version."""
    mitsuba = load_mitsuba()
    scenes: dict[bool, Any] = {}
    for i, view in enumerate(job["views"]):
        matrix = view["camera_to_world"]
        ground = bool(job["lit"]) and scene.sees_ground(matrix, job["floor"], job["radius"])
        if ground not in scenes:
            scenes[ground] = mitsuba.load_dict(scene_of(job, ground))
        sensor = mitsuba.load_dict(sensor_of(job, matrix))
        pixels = mitsuba.render(scenes[ground], sensor=sensor, spp=job["samples"], seed=i)
        write_png(mitsuba, pixels, view["file"])
        toolkit.progress(i + 1, len(job["views"]))
    return mitsuba.__version__
