"""Make a capture of photographs or a video: cameras, an upright world, masks.

    python main.py JOB.json

The job has `source` (a folder of photographs or a video), `out`, `up` (auto or an axis), `floor`
(auto, none or a height), `restart`.
"""

from __future__ import annotations

import errno
import shutil
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tt3d_tools import toolkit

UPRIGHT = "# tt3d: the world is upright, +Z up\n"  # first line of images.txt
AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
WHITE = 127  # level from which a mask pixel is object


def source_files(source: Path) -> list[Any]:
    """Return what tells whether the source has changed: names, sizes, times."""
    if not source.exists():
        raise toolkit.InputProblem(f"{source}: no such file or folder")
    files = [source] if source.is_file() else sorted(p for p in source.iterdir() if p.is_file())
    return [[path.name, path.stat().st_size, path.stat().st_mtime_ns] for path in files]


def make_frames(job: dict[str, Any], folder: Any) -> dict[str, Any]:
    """Step 1."""
    from tt3d_tools.photos import frames
    from tt3d_tools.photos.folder import replace_folder

    toolkit.stage("photographs")
    part = folder.work / "images"
    found = frames.write_frames(Path(job["source"]), part)
    folder.claim(part)
    replace_folder(part, folder.path / "images")
    return {"frames": [asdict(frame) for frame in found]}


def frames_of(entry: dict[str, Any], folder: Any) -> list[Any]:
    """Return the frames of the first step; measures those that the user put there."""
    import cv2

    from tt3d_tools.photos.frames import Frame, sharpness

    recorded = {f["name"]: Frame(**f) for f in entry["facts"].get("frames", [])}
    out = []
    for name in entry["products"]:
        path = folder.path / name
        short = str(Path(name).relative_to("images"))
        if short in recorded:
            out.append(recorded[short])
            continue
        grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if grey is None:
            raise toolkit.InputProblem(f"{path}: cannot be read as a picture")
        height, width = grey.shape
        out.append(Frame(short, short, width, height, sharpness(grey), float(grey.mean()), 0.0))
    return out


def make_cameras(job: dict[str, Any], folder: Any, frames: list[Any]) -> dict[str, Any]:
    """Step 2."""
    from tt3d_tools.photos import cameras, sparse
    from tt3d_tools.photos.folder import replace_folder

    model = cameras.find_cameras(job["source"], frames, folder.path / "images", folder.work)
    made = folder.work / "cameras.part"
    sparse.write_text(model, made)
    folder.claim(made)
    replace_folder(made, folder.work / "cameras")
    return {"registered": len(model.views), "photographs": len(frames), "points": len(model.points)}


def turn_upright(job: dict[str, Any], folder: Any) -> dict[str, Any]:
    """Step 3."""
    import numpy as np

    from tt3d_tools.photos import sparse, upright
    from tt3d_tools.photos.folder import replace_folder

    toolkit.stage("upright")
    model = sparse.read_model(folder.work / "cameras")
    model, facts = upright.stand(model, job["up"])
    made = folder.work / "sparse.part"
    sparse.write_text(model, made)
    images = made / "images.txt"
    images.write_text(UPRIGHT + images.read_text())
    folder.claim(made)
    replace_folder(made, folder.path / "sparse" / "0")
    facts["rotation"] = np.round(facts["rotation"], 9).tolist()
    return facts


def standing_model(folder: Any, job: dict[str, Any]) -> Any:
    """Return the model of sparse/0 with an upright world."""
    from tt3d_tools.photos import sparse, upright

    model = sparse.read_model(folder.path / "sparse" / "0")
    images = folder.path / "sparse/0/images.txt"
    if images.exists() and images.read_text()[: len(UPRIGHT)] == UPRIGHT:
        return model
    return upright.stand(model, job["up"])[0]


def find_floor(model: Any, floor: str) -> Any:
    """Return the object's place with the support plane, as found or as the user sets it."""
    from tt3d_tools.photos import upright

    place = upright.find_place(model)
    if floor == "auto":
        plane = upright.find_plane(model, place)
        if plane is not None:
            normal, offset = plane
            # The height of the plane below the object.
            place.floor = float((offset - normal[:2] @ place.centre[:2]) / normal[2])
    elif floor != "none":
        place.floor = float(floor)
    return place


def own_masks(folder: Any, model: Any) -> dict[int, Any]:
    """Return the masks that the user made, by view, bool [H,W] in the size of the photograph."""
    import cv2

    given = {}
    for name, digest in folder.files("masks/*").items():
        if not folder.is_own(digest):
            continue
        stem = Path(name).stem
        index = [
            i for i, v in enumerate(model.views) if stem in (Path(v.name).stem, Path(v.name).name)
        ]
        mask = cv2.imread(str(folder.path / name), cv2.IMREAD_GRAYSCALE)
        if mask is None or not (index or list((folder.path / "images").glob(f"{stem}.*"))):
            raise toolkit.InputProblem(f"{folder.path / name}: is not the mask of a photograph")
        if index:
            given[index[0]] = mask > WHITE
    return given


def make_masks(
    job: dict[str, Any], folder: Any, model: Any, given: dict[int, Any]
) -> dict[str, Any]:
    """Step 4."""
    import cv2

    from tt3d_tools.photos import masks

    toolkit.stage("masks")
    place = find_floor(model, job["floor"])
    pictures, space, solid = masks.make_masks(model, place, folder.path / "images", given)
    made = folder.work / "masks"
    shutil.rmtree(made, ignore_errors=True)
    made.mkdir()
    for picture in pictures:
        if picture.given:
            continue
        view = model.views[picture.index]
        lens = model.lens(view)
        full = masks.resize_mask(picture.mask, (lens.width, lens.height))
        path = made / (Path(view.name).stem + ".png")
        if not cv2.imwrite(str(path), full.astype("uint8") * 255):
            raise OSError(errno.ENOSPC, "cannot write a mask", str(path))
    folder.claim(made)
    target = folder.path / "masks"
    target.mkdir(exist_ok=True)
    for path in made.iterdir():
        path.replace(target / path.name)
    hull = space.centres[solid]
    return {
        "floor": place.floor,
        "centre": place.centre.tolist(),
        "radius": place.radius,
        "hull": [hull.min(0).tolist(), hull.max(0).tolist()],
        "yours": sorted(model.views[i].name for i in given),
    }


def even_exposure(folder: Any, model: Any, job: dict[str, Any]) -> dict[str, Any]:
    """Step 5."""
    import json

    from tt3d_tools.photos import gains, masks

    chosen = masks.object_points(model, find_floor(model, job["floor"]))
    found = gains.find_gains(model, folder.path / "images", chosen)
    lines = [f" {json.dumps(name)}: {json.dumps(factors)}" for name, factors in found.items()]
    made = folder.work / "gains"
    made.mkdir(exist_ok=True)
    (made / "gains.json").write_text("{\n" + ",\n".join(lines) + "\n}\n")
    folder.claim(made)
    (made / "gains.json").replace(folder.path / "gains.json")
    return {}


def run_steps(job: dict[str, Any]) -> None:
    """Run all steps that are needed."""
    from tt3d_tools.photos.folder import Folder

    folder = Folder(Path(job["out"]), job["restart"])
    source = source_files(Path(job["source"]))
    folder.record["source"] = job["source"]
    frames = folder.step("photographs", source, "images/*", lambda: make_frames(job, folder))
    list_of_frames = frames_of(frames, folder)
    own_model = any(folder.is_own(digest) for digest in folder.files("sparse/0/*").values())
    cameras = {"products": {}}
    if not own_model:
        cameras = folder.step(
            "cameras",
            frames["products"],
            ".work/cameras/*",
            lambda: make_cameras(job, folder, list_of_frames),
            keep=False,
        )
    upright = folder.step(
        "upright",
        [cameras["products"], job["up"]],
        "sparse/0/*",
        lambda: turn_upright(job, folder),
    )
    model = standing_model(folder, job)
    given = own_masks(folder, model)
    own = {n: d for n, d in folder.files("masks/*").items() if folder.is_own(d)}
    inputs = [frames["products"], upright["products"], job["floor"], own]
    folder.step(
        "masks", inputs, "masks/*", lambda: make_masks(job, folder, model, given), keep=False
    )
    inputs = [frames["products"], upright["products"], job["floor"]]
    folder.step("exposure", inputs, "gains.json", lambda: even_exposure(folder, model, job))


def work(arguments: list[str]) -> None:
    """Run the job; name the disk's errors."""
    (path,) = arguments
    job = toolkit.read_job(path)
    for module, package in (("cv2", "opencv-contrib-python-headless"), ("scipy", "scipy")):
        toolkit.need_package(module, "tt3d photos", package)
    toolkit.need_program("colmap", "tt3d photos")
    try:
        run_steps(job)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise toolkit.ToolError(
                f"{job['out']}: the disk is full; free some space and run the same command again"
            ) from error
        raise toolkit.ToolError(
            f"{error.filename or job['out']}: {error.strerror or error}"
        ) from error


if __name__ == "__main__":
    toolkit.main(work)
