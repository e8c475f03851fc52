"""Step 2: cameras. OpenCV finds and matches SIFT features; colmap verifies and reconstructs.

COLMAP's own features and matches give the same cameras, but its CPU matching took 290 s for 32
photographs where the matrix product here takes 75 s (two cores).
"""

from __future__ import annotations

import json
import shutil
import sqlite3
import subprocess
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np

from tt3d_tools import toolkit
from tt3d_tools.photos.frames import Frame
from tt3d_tools.photos.sparse import Model, read_model

FEATURES = 4096  # of each picture
COARSE = 600  # largest features of a picture, to find the pictures that overlap
PARTNERS = 20  # pictures that each is matched with, beside its neighbours
EXHAUSTIVE = 24  # up to this many pictures all pairs are matched
NEIGHBOURS = 4  # of a picture in the order of taking, always matched
RATIO = 0.8  # nearest to second nearest angle (Lowe 2004)
FARTHEST = 0.7  # radians between matched descriptors
PINHOLE_GUESS = 1.2  # focal length over the longer side, without EXIF
ENOUGH = 0.8  # fraction of registered pictures that needs no retry
LEAST = 0.5  # fraction of registered pictures below which there is no capture
SIMPLE_RADIAL = 2  # number of the lens in colmap's database

ADVICE = (
    "take 30 to 60 photographs all around the object in steps of at most 10 degrees, sharp, with "
    "fixed zoom, of an object that has texture, does not shine and does not move against the room"
)

Features = tuple[np.ndarray, np.ndarray]  # keypoints [N,4] x y size angle, descriptors [N,128]


def find_features(path: Path, count: int) -> Features:
    """Return the features of a picture, the largest first, with RootSIFT descriptors."""
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if grey is None:
        raise toolkit.InputProblem(f"{path}: cannot be read")
    sift = cv2.SIFT_create(nfeatures=count, contrastThreshold=0.015)
    found, descriptors = sift.detectAndCompute(grey, None)
    if descriptors is None:
        return np.zeros((0, 4), np.float32), np.zeros((0, 128), np.float32)
    order = np.argsort([-point.size for point in found], kind="stable")[:count]
    # OpenCV's pixel centres are whole numbers.
    keypoints = np.array(
        [
            (found[i].pt[0] + 0.5, found[i].pt[1] + 0.5, found[i].size, np.radians(found[i].angle))
            for i in order
        ],
        np.float32,
    )
    d = descriptors[order]
    return keypoints, np.sqrt(d / np.maximum(d.sum(1, keepdims=True), 1e-6)).astype(np.float32)


def match(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    """Return the pairs [M,2] of mutual nearest neighbours that pass the ratio test."""
    import torch

    if len(one) < 2 or len(two) < 2:
        return np.zeros((0, 2), np.uint32)
    products = torch.from_numpy(one) @ torch.from_numpy(two).T
    best, index = products.topk(2, 1)
    back = products.argmax(0)
    angle = torch.acos(best.clamp(max=1))
    rows = torch.arange(len(one))
    good = (angle[:, 0] < RATIO * angle[:, 1]) & (angle[:, 0] < FARTHEST)
    good &= back[index[:, 0]] == rows
    return torch.stack([rows[good], index[good, 0]], 1).numpy().astype(np.uint32)


def pairs_to_match(features: list[Features]) -> list[tuple[int, int]]:
    """Return the pairs of pictures that probably overlap."""
    n = len(features)
    if n <= EXHAUSTIVE:
        return [(i, j) for i in range(n) for j in range(i + 1, n)]
    counts = np.zeros((n, n), int)
    coarse = [descriptors[:COARSE] for _, descriptors in features]
    for i in range(n):
        for j in range(i + 1, n):
            counts[i, j] = counts[j, i] = len(match(coarse[i], coarse[j]))
    pairs = {(i, j) for i in range(n) for j in range(i + 1, min(n, i + 1 + NEIGHBOURS))}
    for i in range(n):
        for j in np.argsort(-counts[i], kind="stable")[:PARTNERS]:
            if i != j:
                pairs.add((min(i, int(j)), max(i, int(j))))
    return sorted(pairs)


def create_database(path: Path, frames: list[Frame], features: list[Features]) -> None:
    """Write colmap's database with cameras, pictures and keypoints: one camera for each size."""
    path.unlink(missing_ok=True)
    toolkit.run_checked(["colmap", "database_creator", "--database_path", str(path)], "colmap")
    with sqlite3.connect(path) as database:
        cameras: dict[tuple[int, int], int] = {}
        for number, (frame, (keypoints, _)) in enumerate(zip(frames, features, strict=True), 1):
            size = (frame.width, frame.height)
            if size not in cameras:
                cameras[size] = len(cameras) + 1
                known = frame.focal_px > 0
                focal = frame.focal_px if known else PINHOLE_GUESS * max(size)
                lens = np.array([focal, size[0] / 2, size[1] / 2, 0.0])
                database.execute(
                    "INSERT INTO cameras VALUES (?,?,?,?,?,?)",
                    (cameras[size], SIMPLE_RADIAL, *size, lens.tobytes(), int(known)),
                )
            database.execute(
                "INSERT INTO images (image_id, name, camera_id) VALUES (?,?,?)",
                (number, frame.name, cameras[size]),
            )
            database.execute(
                "INSERT INTO keypoints VALUES (?,?,?,?)",
                (number, len(keypoints), 4, keypoints.astype(np.float32).tobytes()),
            )
    database.close()


def watch_colmap(command: list[str], mark: str, total: int, log: Path) -> None:
    """Run colmap; each line with `mark` is a step of the progress."""
    done = 0
    with (
        open(log, "a") as out,
        subprocess.Popen(
            ["colmap", *command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        ) as child,
    ):
        assert child.stdout is not None
        for line in child.stdout:
            out.write(line)
            if mark in line:
                done = min(done + 1, total)
                toolkit.progress(done, total)
    if child.returncode != 0:
        lines = [line for line in log.read_text().splitlines() if line.strip()]
        last = lines[-1] if lines else "no message"
        if "failed to create sparse model" in last:
            return  # no two pictures fit together; check_registered gives advice
        raise toolkit.ToolError(f"colmap {command[0]} failed: {last} (see {log})")


def match_pictures(frames: list[Frame], images: Path, work: Path, effort: int) -> Path:
    """Write the database with features and raw matches; return the text of the matches.

    Both are kept if an interrupted call with the same pictures has completed them.
    """
    text, stamp = work / "matches.txt", work / "matches.json"
    key = json.dumps([effort, [asdict(frame) for frame in frames]])
    if stamp.exists() and stamp.read_text() == key and text.exists():
        return text
    stamp.unlink(missing_ok=True)
    toolkit.stage("features")
    features = []
    for number, frame in enumerate(frames, 1):
        features.append(find_features(images / frame.name, FEATURES * effort))
        toolkit.progress(number, len(frames))
    toolkit.stage("matches")
    create_database(work / "database.db", frames, features)
    every = [(i, j) for i in range(len(frames)) for j in range(i + 1, len(frames))]
    pairs = pairs_to_match(features) if effort == 1 else every
    with open(text, "w") as out:
        for number, (i, j) in enumerate(pairs, 1):
            found = match(features[i][1], features[j][1])
            if len(found) >= 15:
                lines = "".join(f"{a} {b}\n" for a, b in found)
                out.write(f"{frames[i].name} {frames[j].name}\n{lines}\n")
            toolkit.progress(number, len(pairs))
    stamp.write_text(key)
    return text


def reconstruct(frames: list[Frame], images: Path, work: Path, effort: int) -> list[Model]:
    """Return the models that colmap makes, the one with the most pictures first."""
    text = match_pictures(frames, images, work, effort)
    database, log = str(work / "database.db"), work / "colmap.log"
    toolkit.stage("verification")
    toolkit.progress(0, 1)
    command = ["matches_importer", "--database_path", database, "--match_list_path", str(text)]
    command += ["--match_type", "raw", "--SiftMatching.use_gpu", "0"]
    watch_colmap(command, "Elapsed", 1, log)
    toolkit.stage("cameras")
    models = work / "models"
    shutil.rmtree(models, ignore_errors=True)
    models.mkdir()
    command = ["mapper", "--database_path", database, "--image_path", str(images)]
    command += ["--output_path", str(models), "--Mapper.min_model_size", "5"]
    if effort > 1:
        command += ["--Mapper.init_min_tri_angle", "6", "--Mapper.init_min_num_inliers", "50"]
        command += ["--Mapper.abs_pose_min_num_inliers", "20"]
    watch_colmap(command, "Registering image", len(frames), log)
    found = [read_model(folder) for folder in sorted(models.iterdir()) if folder.is_dir()]
    return sorted(found, key=lambda model: -len(model.views))


def names_of(names: list[str]) -> str:
    """Return up to six names, and how many more there are."""
    more = f" and {len(names) - 6} more" if len(names) > 6 else ""
    return ", ".join(names[:6]) + more


def blurred(frames: list[Frame]) -> bool:
    """Tell whether most pictures are blurred."""
    return bool(np.median([frame.sharpness for frame in frames]) < 0.35)


def check_registered(source: str, frames: list[Frame], models: list[Model]) -> None:
    """Raise InputProblem with advice if too few pictures have cameras; name the others."""
    best = models[0] if models else None
    count = len(best.views) if best else 0
    if blurred(frames) and count < ENOUGH * len(frames):
        raise toolkit.InputProblem(
            f"{source}: most photographs are blurred, and only {count} of {len(frames)} could be "
            "placed; take them again with more light and a steady hand"
        )
    if best is None or count < max(8, LEAST * len(frames)):
        raise toolkit.InputProblem(
            f"{source}: only {count} of {len(frames)} photographs show the same thing from cameras "
            f"that could be found; {ADVICE}"
        )
    placed = {view.name for view in best.views}
    rest = [frame.name for frame in frames if frame.name not in placed]
    if rest:
        others = f"; they form {len(models) - 1} other groups" if len(models) > 1 else ""
        toolkit.note(
            f"{len(rest)} photographs have no camera and are left out{others}: {names_of(rest)}"
        )


def find_cameras(source: str, frames: list[Frame], images: Path, work: Path) -> Model:
    """Return the largest model of the pictures, after a second try with more effort if needed."""
    toolkit.need_program("colmap", "tt3d photos")
    (work / "colmap.log").unlink(missing_ok=True)
    models = reconstruct(frames, images, work, 1)
    if not models or len(models[0].views) < ENOUGH * len(frames):
        count = len(models[0].views) if models else 0
        if not blurred(frames):
            toolkit.note(
                f"{count} of {len(frames)} photographs have a camera; trying with more features"
            )
            again = reconstruct(frames, images, work, 2)
            if again and len(again[0].views) > count:
                models = again
    check_registered(source, frames, models)
    return models[0]
