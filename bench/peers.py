"""Compare renderers and kernels with their peers and with the machine's limits.

All times are for forward and backward. DEODR draws coloured faces, Mitsuba 3 (llvm_ad_rgb) a
textured emitter. Both draw the same triangles as tt3d from the same camera at 400 x 400. The
rasteriser and the hash encoding are also compared with plain tensor operations. tt3d runs as the
program kernel_bench, the peer in its own process. The rounds alternate, and a ratio is the median
over the rounds. The program rewrites its section of docs/benchmarks.md.

    scripts/bench peers [--rounds 7] [--threads N]
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
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from page import processor, write_section
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
        sys.exit("peers: DEODR's picture does not show the object")
    return step


def find_llvm() -> str | None:
    """Return the newest LLVM library; Mitsuba with one older than 17 crashes on AVX-512."""
    if chosen := os.environ.get("DRJIT_LIBLLVM_PATH"):
        return chosen
    found = sorted(Path("/usr/lib/x86_64-linux-gnu").glob("libLLVM.so.*"))
    return str(found[-1]) if found else None


def mitsuba_step(mesh: dict[str, np.ndarray], folder: Path) -> Callable[[], None] | None:
    """Return a step of Mitsuba: render a textured emitter, gradient to the texture."""
    library = find_llvm()
    if library is None:
        print("peers: Mitsuba needs LLVM; run: apt-get install libllvm19", file=sys.stderr)
        return None
    os.environ["DRJIT_LIBLLVM_PATH"] = library
    import drjit
    import mitsuba

    mitsuba.set_variant("llvm_ad_rgb")
    drjit.set_thread_count(1)
    count = len(mesh["vertices"])
    surface = mitsuba.Mesh("m", count, len(mesh["faces"]), has_vertex_texcoords=True)
    values = mitsuba.traverse(surface)
    values["vertex_positions"] = mesh["vertices"].ravel()
    values["faces"] = mesh["faces"].ravel().astype(np.uint32)
    values["vertex_texcoords"] = mesh["uvs"].ravel()
    values.update()
    surface.write_ply(str(folder / "mesh.ply"))
    texels = np.random.default_rng(1).random((512, 512, 3), dtype=np.float32)
    to_world = mitsuba.ScalarTransform4f().look_at([0, -DISTANCE, 0], [0, 0, 0], [0, 0, 1])
    scene = mitsuba.load_dict({
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 1},  # emission alone
        "sensor": {
            "type": "perspective", "fov": float(np.rad2deg(FIELD_OF_VIEW)), "to_world": to_world,
            "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}},
            "sampler": {"type": "independent", "sample_count": 1},
        },
        "object": {
            "type": "ply", "filename": str(folder / "mesh.ply"),
            "emitter": {"type": "area", "radiance": {
                "type": "bitmap", "bitmap": mitsuba.Bitmap(texels), "raw": True,
            }},
        },
    })  # fmt: skip
    parameters = mitsuba.traverse(scene)
    key = next(k for k in parameters.keys() if k.endswith("radiance.data"))  # noqa: SIM118

    def step() -> None:
        drjit.enable_grad(parameters[key])
        parameters.update()
        picture = mitsuba.render(scene, parameters, spp=1)
        drjit.backward(drjit.sum(drjit.square(picture), axis=None))
        drjit.eval(drjit.grad(parameters[key]))
        drjit.sync_thread()

    if not 0.1 < (np.array(mitsuba.render(scene, spp=1)).sum(2) > 0).mean() < 0.9:
        sys.exit("peers: Mitsuba's picture does not show the object")
    return step


# ---- The machine's limits ---------------------------------------------------------------------

PIXELS = SIZE * SIZE
POINTS = 1 << 18
#: The least work of a step: multiply-adds, or the bytes that every operator reads or writes once
#: (rast 16, colours 12, UVs 8 and derivatives 16 bytes a pixel).
WORK = {
    "colored_mesh": ("bytes", 236 * PIXELS),
    "textured_mesh": ("bytes", 180 * PIXELS + 2 * 12 * 512 * 512),
    # Eight entries of 8 bytes a point and level, read forward, read and written backward.
    "hash_encode_ours": ("bytes", 3 * 64 * 16 * POINTS + 2 * 4 * 32 * POINTS),
    "mlp_ours": ("multiply-adds", 3 * (35 * 64 + 64 * 64 + 64 * 6) * (1 << 17)),
}
LEFT = {
    "colored_mesh": "triangles cover a few pixels; setting one up costs more than drawing it",
    "textured_mesh": "the same, and the texels are far apart in memory",
    "hash_encode_ours": "a cache line of 64 bytes is fetched for each entry of 8",
    "mlp_ours": "half is the loops; the rest is new memory and the autograd graph",
}  # fmt: skip


def roofs(threads: int) -> dict[str, float]:
    """Return the machine's bytes and multiply-adds a second, measured."""
    done = subprocess.run(
        [PROGRAM, "--benchmark_filter=^roof_", "--benchmark_format=json"],
        env={**os.environ, "OMP_NUM_THREADS": str(threads)},
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    by_name = {b["name"].split("/")[0]: b for b in json.loads(done.stdout)["benchmarks"]}
    return {
        "bytes": by_name["roof_bandwidth"]["bytes_per_second"],
        "multiply-adds": by_name["roof_multiply_adds"]["items_per_second"],
    }


@dataclass
class Row:
    """One comparison: median seconds of both sides, and the median ratio of the rounds."""

    label: str
    name: str
    threads: int
    ours: float
    peer: float | None = None
    ratio: float | None = None


def compare(
    label: str, name: str, threads: int, mesh: Path, peer: Callable[[], float], rounds: int
) -> Row:
    """Return a row: medians over alternating rounds."""
    pairs = [(time_of_ours(name, mesh, threads), peer()) for _ in range(rounds)]
    ratio = statistics.median(b / a for a, b in pairs)
    print(f"{label}: {ratio:.2f}x", file=sys.stderr, flush=True)
    ours, theirs = (statistics.median(column) for column in zip(*pairs, strict=True))
    return Row(label, name, threads, ours, theirs, ratio)


def measure(options: argparse.Namespace, folder: Path) -> list[Row]:
    """Run all comparisons."""
    mesh, path, every = bumpy_ball(), folder / "mesh.safetensors", options.threads
    save_file({
        "clip": clip_positions(mesh["vertices"]), "faces": mesh["faces"],
        "colors": mesh["colors"], "uvs": mesh["uvs"],
    }, path)  # fmt: skip

    def row(label: str, name: str, threads: int, peer: Callable[[], float]) -> Row:
        return compare(label, name, threads, path, peer, options.rounds)

    deodr, rows = deodr_step(mesh), []
    rows.append(
        row("DEODR 0.2.3, 50,000 coloured faces", "colored_mesh", 1, lambda: time_of(deodr))
    )
    rows.append(row("the same, DEODR on one", "colored_mesh", every, lambda: time_of(deodr)))
    mitsuba = mitsuba_step(mesh, folder)
    if mitsuba:
        label = "Mitsuba 3.9.1 llvm_ad_rgb, 50,000 textured faces"
        rows.append(row(label, "textured_mesh", 1, lambda: time_of(mitsuba)))
    for label, name, threads in [
        ("the rasteriser in plain tensor operations, 968 faces, 128 x 128", "rasterize", 1),
        ("hash encoding in plain tensor operations, 2^18 points", "hash_encode", 1),
        ("the same", "hash_encode", every),
    ]:
        plain = f"{name}_plain_tensors"
        rows.append(
            row(label, f"{name}_ours", threads,
                lambda plain=plain, n=threads: time_of_ours(plain, path, n))
        )  # fmt: skip
    label = "hash encoding, tt3d's own on one thread"
    rows.append(
        row(label, "hash_encode_ours", every, lambda: time_of_ours("hash_encode_ours", path, 1))
    )
    for threads in (1, every):
        seconds = statistics.median(
            time_of_ours("mlp_ours", path, threads) for _ in range(options.rounds)
        )
        rows.append(
            Row("the colour network, 2^17 points, 35-64-64-6", "mlp_ours", threads, seconds)
        )
    return rows


def table(rows: list[Row], every: int) -> str:
    """Return the rows, each with its share of the machine's limits, as Markdown."""
    limits = {threads: roofs(threads) for threads in (1, every)}
    lines = [
        "| against | threads | tt3d, ms | peer, ms | peer / tt3d | share of the roof |",
        "|---|---|---|---|---|---|",
    ]
    for r in rows:
        share = ""
        if r.name in WORK:
            unit, amount = WORK[r.name]
            share = f"{100 * amount / r.ours / limits[r.threads][unit]:.0f} % of {unit}"
        peer = f"{1000 * r.peer:.1f} | {r.ratio:.{1 if r.ratio >= 10 else 2}f}" if r.peer else "| "
        lines.append(f"| {r.label} | {r.threads} | {1000 * r.ours:.1f} | {peer} | {share} |")
    lines += ["", "The roof, measured in the same run: " + "; ".join(
        f"{n} thread{'s' if n > 1 else ''}: {v['bytes'] / 1e9:.1f} GB/s, "
        f"{v['multiply-adds'] / 1e9:.0f} G multiply-adds/s" for n, v in limits.items()
    ) + ". Where the rest goes:", ""]  # fmt: skip
    lines += [f"- {name}: {why}." for name, why in LEFT.items()]
    return "\n".join(lines)


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = measure(options, Path(folder))
    text = (
        f"Medians of {options.rounds} rounds on {processor()}, load average "
        f"{os.getloadavg()[0]:.1f} at the end.\n\n" + table(rows, options.threads)
    )
    print(text)
    write_section("peers", text)


if __name__ == "__main__":
    main()
