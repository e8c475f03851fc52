"""Renders one mesh with tt3d and DEODR, forward and backward, in turns, and prints the ratios as a
Markdown table; then our kernels against plain tensor operations.

Both draw the same triangles from the same camera at 400 x 400. tt3d runs as the program
kernel_bench, the peer in this process; rounds alternate, and a ratio is the median over rounds.

    scripts/bench peers
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from safetensors.numpy import save_file

ROOT = Path(__file__).resolve().parents[1]
PROGRAM = ROOT / "build/release/bench/kernel_bench"
SIZE = 400
FIELD_OF_VIEW = np.deg2rad(40)
DISTANCE = 3.5
SECONDS = 1.0  # a round of one program


def bumpy_ball(rings: int = 125, sectors: int = 200) -> dict[str, np.ndarray]:
    """Return a closed surface of 2 * rings * sectors triangles (50,000) with UVs and colours."""
    v, u = np.meshgrid(
        np.linspace(0.02, np.pi - 0.02, rings + 1),
        np.linspace(0, 2 * np.pi, sectors + 1),
        indexing="ij",
    )
    radius = 1 + 0.1 * np.sin(5 * u) * np.sin(4 * v)
    points = np.stack([np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)], -1)
    vertices = (radius[..., None] * points).reshape(-1, 3)
    row = sectors + 1
    corner = (np.arange(rings)[:, None] * row + np.arange(sectors)).reshape(-1)
    faces = np.concatenate(
        [
            np.stack([corner, corner + row, corner + row + 1], 1),
            np.stack([corner, corner + row + 1, corner + 1], 1),
        ]
    )
    uvs = np.stack([u / (2 * np.pi), v / np.pi], -1).reshape(-1, 2)
    return {
        "vertices": vertices.astype(np.float32),
        "faces": faces.astype(np.int32),
        "uvs": uvs.astype(np.float32),
        "colors": (0.5 + 0.5 * vertices / np.abs(vertices).max()).astype(np.float32),
    }


def clip_positions(vertices: np.ndarray) -> np.ndarray:
    """Return the vertices in clip space [1,V,4], seen along +y from (0,-DISTANCE,0), z up."""
    focal = 1 / np.tan(FIELD_OF_VIEW / 2)
    near, far = 1.0, 10.0
    x, depth, y = vertices[:, 0], vertices[:, 1] + DISTANCE, vertices[:, 2]
    z = depth * (far + near) / (far - near) - 2 * far * near / (far - near)
    return np.stack([focal * x, focal * y, z, depth], 1)[None].astype(np.float32)


def time_of(step: Callable[[], None]) -> float:
    """Return seconds a step, the mean of about SECONDS of steps."""
    begin, steps = time.perf_counter(), 0
    while time.perf_counter() - begin < SECONDS:
        step()
        steps += 1
    return (time.perf_counter() - begin) / steps


def time_of_ours(name: str, mesh: Path, threads: int) -> float:
    """Return seconds a step of one of our benchmarks."""
    done = subprocess.run(
        [PROGRAM, f"--benchmark_filter=^{name}/", "--benchmark_format=json",
         f"--benchmark_min_time={SECONDS}"],
        env={**os.environ, "TT3D_BENCH_MESH": str(mesh), "OMP_NUM_THREADS": str(threads)},
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    return json.loads(done.stdout)["benchmarks"][0]["real_time"] / 1000


def deodr_step(mesh: dict[str, np.ndarray]) -> Callable[[], None]:
    """Return a step of DEODR: vertex colours, gradients to vertices and colours."""
    from deodr.differentiable_renderer import Camera, Scene3D
    from deodr.triangulated_mesh import ColoredTriMesh

    focal = SIZE / 2 / np.tan(FIELD_OF_VIEW / 2)
    # World to camera: x right, y down, z forward.
    rotation = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    extrinsic = np.column_stack((rotation, [0, 0, DISTANCE]))
    intrinsic = np.array([[focal, 0, SIZE / 2], [0, focal, SIZE / 2], [0, 0, 1]])
    camera = Camera(extrinsic=extrinsic, intrinsic=intrinsic, height=SIZE, width=SIZE)
    surface = ColoredTriMesh(
        mesh["faces"], mesh["vertices"].astype(np.float64),
        colors=mesh["colors"].astype(np.float64), nb_colors=3,
    )  # fmt: skip
    scene = Scene3D(sigma=1)
    scene.set_mesh(surface)
    scene.set_light(light_directional=None, light_ambient=1.0)
    scene.set_background_color(np.zeros(3))

    def step() -> None:
        scene.clear_gradients()
        picture = scene.render(camera)
        scene.render_backward(2 * picture)

    if not 0.1 < (scene.render(camera).sum(2) > 0).mean() < 0.9:
        sys.exit("peers: DEODR does not see the object")
    return step


def compare(label: str, ours: Callable[[], float], peer: Callable[[], float], rounds: int) -> str:
    """Return a row: rounds in turns, medians."""
    pairs = [(ours(), peer()) for _ in range(rounds)]
    ratio = statistics.median(b / a for a, b in pairs)
    ours_ms, peer_ms = (1000 * statistics.median(column) for column in zip(*pairs, strict=True))
    print(f"{label}: {ratio:.1f}x", file=sys.stderr, flush=True)
    return f"| {label} | {ours_ms:.2f} | {peer_ms:.2f} | {ratio:.1f} |"


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    options = parser.parse_args()
    mesh = bumpy_ball()
    rows = ["| against | tt3d, ms | peer, ms | peer / tt3d |", "|---|---|---|---|"]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mesh.safetensors"
        save_file({
            "clip": clip_positions(mesh["vertices"]), "faces": mesh["faces"],
            "colors": mesh["colors"], "uvs": mesh["uvs"],
        }, path)  # fmt: skip
        deodr = deodr_step(mesh)
        all_threads = options.threads
        plan = [
            ("DEODR 0.2.3, 50,000 coloured faces, one thread each", "colored_mesh", deodr, 1),
            (f"DEODR 0.2.3 (one thread), tt3d {all_threads}", "colored_mesh", deodr, all_threads),
        ]  # fmt: skip
        for label, name, step, threads in plan:
            rows.append(
                compare(
                    label,
                    lambda name=name, threads=threads: time_of_ours(name, path, threads),
                    lambda step=step: time_of(step),
                    options.rounds,
                )
            )
        for label, name, threads in [
            ("the rasteriser in plain tensor operations, 968 faces, 128 x 128", "rasterize", 1),
            ("hash encoding in plain tensor operations, 2^18 points, one thread", "hash_encode", 1),
            (f"the same, {all_threads} threads", "hash_encode", all_threads),
        ]:
            rows.append(
                compare(
                    label,
                    lambda name=name, n=threads: time_of_ours(f"{name}_ours", path, n),
                    lambda name=name, n=threads: time_of_ours(f"{name}_plain_tensors", path, n),
                    options.rounds,
                )
            )
    print("\n".join(rows))


if __name__ == "__main__":
    main()
