"""Compare our CUDA kernels with nvdiffrast and tiny-cuda-nn, and an attack with eager PyTorch.

    python bench/gpu_peers.py [--rounds 3] [--out FILE.md]
    python bench/gpu_peers.py --attack RUN [--surrogate resnet101] [--out FILE.md]

The peers are not part of this project. Build them from your own copies and put them on PYTHONPATH;
a missing peer is reported in one line. Our kernels run in the program gpu_speed, a peer in this
process. The rounds alternate, and a ratio is the median over the rounds. --attack times the program
on a run folder that has its mesh, with 64 views of 400 x 400 pixels a step. It is compared with the
same step in PyTorch's eager mode, one view at a time, as in the official code.
"""

from __future__ import annotations

import argparse
import json
import math
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import torch
from page import markdown_table
from peers import WORK, bumpy_ball, clip_positions
from safetensors.numpy import save_file

ROOT = Path(__file__).resolve().parents[1]
PROGRAM = ROOT / "build/cuda/bench/gpu_speed"
TT3D = ROOT / "build/cuda/tt3d"
POINTS = 1 << 18
ROUNDS, CALLS = 5, 20
GPU = "cuda"


def sustained_ms(step: Callable[[], None]) -> float:
    """Return milliseconds of one call in a series of calls, measured as in gpu_speed."""
    for _ in range(CALLS):
        step()
    times = []
    for _ in range(ROUNDS):
        torch.cuda.synchronize()
        begin = time.perf_counter()
        for _ in range(CALLS):
            step()
        torch.cuda.synchronize()
        times.append(1e3 * (time.perf_counter() - begin) / CALLS)
    return statistics.median(times)


def nvdiffrast_step(mesh: dict, views: int, size: int) -> Callable[[], None]:
    """Return nvdiffrast's step: rasterize, interpolate colours, antialias, and back."""
    import nvdiffrast.torch as dr

    context = dr.RasterizeCudaContext()
    clip = torch.from_numpy(clip_positions(mesh["vertices"])).to(GPU)
    clip = clip.expand(views, -1, -1).contiguous().requires_grad_()
    faces = torch.from_numpy(mesh["faces"]).to(GPU)
    colors = torch.from_numpy(mesh["colors"]).to(GPU).requires_grad_()
    edges = dr.antialias_construct_topology_hash(faces)

    def step() -> None:
        clip.grad = colors.grad = None
        rast, _ = dr.rasterize(context, clip, faces, (size, size), grad_db=False)
        color, _ = dr.interpolate(colors[None], rast, faces)
        picture = dr.antialias(color, rast, clip, faces, topology_hash=edges)
        picture.backward(torch.ones_like(picture))

    return step


def tiny_cuda_nn_step(compiled: bool) -> Callable[[], None]:
    """Return tiny-cuda-nn's training step: hash grid, fused network 32-64-64-6, Adam.

    With `compiled` it is one kernel, compiled at the first call; a build may leave that out.
    """
    import tinycudann as tcnn

    model = tcnn.NetworkWithInputEncoding(
        3, 6,
        {"otype": "HashGrid", "n_levels": 16, "n_features_per_level": 2, "log2_hashmap_size": 19,
         "base_resolution": 16, "per_level_scale": math.exp(math.log(2048 / 16) / 15)},
        {"otype": "FullyFusedMLP", "activation": "ReLU", "output_activation": "None",
         "n_neurons": 64, "n_hidden_layers": 2},
    )  # fmt: skip
    if compiled:
        model.jit_fusion = True
    adam = torch.optim.Adam(model.parameters(), lr=1e-3, betas=(0.9, 0.99), eps=1e-15, fused=True)
    x = torch.rand(POINTS, 3, device=GPU)
    target = torch.rand(POINTS, 6, device=GPU)

    def step() -> None:
        adam.zero_grad()
        torch.nn.functional.mse_loss(model(x).float(), target).backward()
        adam.step()

    step()
    if compiled and not model.jit_fusion:
        raise ImportError("built without compilation at run time")
    return step


# ---- The GPU's limits ---------------------------------------------------------------------------

#: Numbers in the training step's hash grid: 16 levels of at most 2^19 entries of 2.
PARAMETERS = 12_285_336
#: The least bytes of a step: a picture as bench/peers.py counts it; for training, the grid's
#: look-ups and Adam's seven passes over the parameters.
BYTES = {
    "colored_mesh 1x400": 236 * 400**2,
    "colored_mesh 8x512": 236 * 8 * 512**2,
    "colored_mesh 1x2048": 236 * 2048**2,
    "training_step half": WORK["hash_encode_ours"][1] + 28 * PARAMETERS,
    "training_step": WORK["hash_encode_ours"][1] + 28 * PARAMETERS,
}
#: Multiply-adds of a picture through ResNet-101 (7.8e9) and of its gradient to the picture.
NETWORK = 2 * 7.8e9


def bytes_a_second() -> float:
    """Return the bytes a second that a copy on the device reads and writes."""
    source = torch.rand(1 << 29, device=GPU)
    target = torch.empty_like(source)
    return 2 * source.nbytes / (1e-3 * sustained_ms(lambda: target.copy_(source)))


def multiply_adds_a_second() -> float:
    """Return the rate of a large matrix product in TF32, the default of convolutions."""
    allowed, torch.backends.cuda.matmul.allow_tf32 = torch.backends.cuda.matmul.allow_tf32, True
    a = torch.rand(8192, 8192, device=GPU)
    seconds = 1e-3 * sustained_ms(lambda: a.mm(a))
    torch.backends.cuda.matmul.allow_tf32 = allowed
    return 8192**3 / seconds


def ours(mesh: Path) -> dict[str, float]:
    """Return milliseconds of our steps."""
    done = subprocess.run([PROGRAM, "--peers", mesh], check=True, capture_output=True, text=True)
    return json.loads(done.stdout)


def compare_kernels(rounds: int) -> str:
    """Return the table of kernels."""
    mesh = bumpy_ball()
    prepared: dict[str, Callable[[], None]] = {}
    missing = []
    try:
        for views, size in [(1, 400), (8, 512), (1, 2048)]:
            prepared[f"colored_mesh {views}x{size}"] = nvdiffrast_step(mesh, views, size)
    except ImportError as error:
        missing.append(f"nvdiffrast: {error}")
    for name, compiled in [("training_step half", False), ("training_step half, compiled", True)]:
        try:
            prepared[name] = tiny_cuda_nn_step(compiled)
        except (ImportError, OSError, RuntimeError) as error:
            missing.append(f"{name} of tiny-cuda-nn: {error}")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mesh.safetensors"
        save_file({
            "clip": clip_positions(mesh["vertices"]), "faces": mesh["faces"],
            "colors": mesh["colors"], "uvs": mesh["uvs"],
        }, path)  # fmt: skip
        pairs = [
            (ours(path), {n: sustained_ms(step) for n, step in prepared.items()})
            for _ in range(rounds)
        ]
    labels = {
        "colored_mesh 1x400": "nvdiffrast, 50,000 coloured faces, 400 x 400",
        "colored_mesh 8x512": "nvdiffrast, the same, 8 views of 512 x 512",
        "colored_mesh 1x2048": "nvdiffrast, the same, 2048 x 2048",
        "training_step half": "tiny-cuda-nn, hash grid and network, 2^18 points, ours `--half-mlp`",
        "training_step half, compiled": "the same, with its `jit_fusion`",
        "training_step": "the first, ours in float32",
    }
    rows, roof = [], bytes_a_second()
    for name, label in labels.items():
        mine_name = name.removesuffix(", compiled")
        peer_name = "training_step half" if name == "training_step" else name
        mine = statistics.median(m[mine_name] for m, _ in pairs)
        row = [label, f"{mine:.3f}", "not measured", ""]
        if peer_name in prepared:
            theirs = statistics.median(p[peer_name] for _, p in pairs)
            ratio = statistics.median(p[peer_name] / m[mine_name] for m, p in pairs)
            row[2:] = [f"{theirs:.3f}", f"{ratio:.2f}"]
        row.append(f"{100 * BYTES[mine_name] / (1e-3 * mine) / roof:.0f} % of bytes")
        rows.append(row)
    header = ["against", "tt3d, ms", "peer, ms", "peer / tt3d", "share of the roof"]
    table = markdown_table(header, rows)
    table += f"\nThe roof, measured in the same run: a copy moves {roof / 1e12:.1f} TB/s.\n"
    return table + "".join(f"\nNot measured: {line}.\n" for line in missing)


# ---- A whole attack ---------------------------------------------------------------------------


def attack_seconds(run: Path, surrogate: str, steps: int, views: int, *options: str) -> float:
    """Return the seconds of the program's attack with `steps` steps, start-up included."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "run"
        shutil.copytree(run, copy)
        subprocess.run(
            [TT3D, "attack", copy, "--target", "teapot", "--surrogate", surrogate, "--device",
             "cuda", "--set", f"attack.steps={steps}", "--set", f"attack.views_per_step={views}",
             "--set", "attack.image_size=400", "-q", *options],
            check=True, stdout=subprocess.DEVNULL,
        )  # fmt: skip
        record = json.loads((copy / "run.json").read_text(encoding="utf-8"))
        return next(s["seconds"] for s in record["stages"] if s["name"] == "attack")


def pictures_a_second(run: Path, surrogate: str, *options: str) -> float:
    """Return the program's pictures a second, start-up excluded."""
    views, few, many = 64, 5, 45
    seconds = [attack_seconds(run, surrogate, n, views, *options) for n in (few, many)]
    return views * (many - few) / (seconds[1] - seconds[0])


def eager_step() -> Callable[[], None]:
    """Return one step of one view, as in the official code but without its regularisers.

    It renders at 800 x 800 with nvdiffrast, takes colours from tiny-cuda-nn's grid and layers of
    torch, halves the picture, applies transforms, and runs ResNet-101 and Adam.
    """
    import nvdiffrast.torch as dr
    import tinycudann as tcnn
    import torchvision
    from torch.nn.functional import avg_pool2d, grid_sample, interpolate

    mesh = bumpy_ball()
    context = dr.RasterizeCudaContext()
    clip = torch.from_numpy(clip_positions(mesh["vertices"])).to(GPU)
    rest = torch.from_numpy(mesh["vertices"]).to(GPU)
    faces = torch.from_numpy(mesh["faces"]).to(GPU)
    offsets = torch.zeros_like(rest, requires_grad=True)
    grid = tcnn.Encoding(
        3, {"otype": "HashGrid", "n_levels": 16, "n_features_per_level": 2,
            "log2_hashmap_size": 19, "base_resolution": 16,
            "per_level_scale": math.exp(math.log(2048 / 16) / 15)},
    )  # fmt: skip
    layers = torch.nn.Sequential(
        torch.nn.Linear(35, 64, bias=False), torch.nn.ReLU(),
        torch.nn.Linear(64, 64, bias=False), torch.nn.ReLU(),
        torch.nn.Linear(64, 6, bias=False), torch.nn.Sigmoid(),
    ).to(GPU)  # fmt: skip
    network = torchvision.models.resnet101(weights=None).to(GPU).eval().requires_grad_(False)
    adam = torch.optim.Adam([*grid.parameters(), *layers.parameters(), offsets], lr=1e-2, eps=1e-15)
    blur = torchvision.transforms.GaussianBlur(5)
    normalize = torchvision.transforms.Normalize([0.485, 0.456, 0.406], [0.229, 0.224, 0.225])
    target = torch.tensor([849], device=GPU)

    def step() -> None:
        adam.zero_grad()
        placed = clip + torch.nn.functional.pad(offsets, (0, 1))
        rast, _ = dr.rasterize(context, placed, faces, (800, 800), grad_db=False)
        points, _ = dr.interpolate(rest[None], rast, faces)
        covered = (rast[..., 3] > 0).view(-1)
        at = points.view(-1, 3)[covered]
        features = torch.cat([at, grid(at * 0.4 + 0.5).float()], 1)
        color = torch.zeros(800 * 800, 4, device=GPU)
        color[covered] = torch.nn.functional.pad(layers(features)[:, :3], (0, 1), value=1.0)
        picture = dr.antialias(color.view(1, 800, 800, 4), rast, placed, faces)
        rgba = avg_pool2d(picture.permute(0, 3, 1, 2), 2)
        rgb = rgba[:, :3] + 1 - rgba[:, 3:]
        rgb = torch.nn.functional.pad(rgb, (60, 60, 60, 60), value=1.0)
        rgb = torchvision.transforms.functional.adjust_brightness(rgb, 1.1)
        rgb = torchvision.transforms.functional.adjust_contrast(rgb, 1.1)
        rgb = torchvision.transforms.functional.adjust_saturation(rgb, 0.9)
        turn = torch.tensor([[[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0]]], device=GPU)
        where = torch.nn.functional.affine_grid(turn, list(rgb.shape), align_corners=False)
        rgb = blur(grid_sample(rgb, where, align_corners=False))
        seen = normalize(interpolate(rgb, (224, 224), mode="bilinear", align_corners=False))
        loss = torch.nn.functional.cross_entropy(network(seen), target)
        (loss + offsets.square().mean()).backward()
        adam.step()

    return step


def compare_attack(run: Path, surrogate: str) -> str:
    """Return the table of whole attacks."""
    theirs = 1e3 / sustained_ms(eager_step())
    roof = multiply_adds_a_second() / NETWORK
    rows = [
        ["eager PyTorch, a view a step", f"{theirs:.1f}", "1.0", f"{100 * theirs / roof:.1f} %"]
    ]
    for label, options in [
        ("tt3d, 64 views a step", []),
        ("the same, `--half-mlp --cuda-graphs`", ["--half-mlp", "--cuda-graphs"]),
    ]:
        mine = pictures_a_second(run, surrogate, *options)
        rows.append([label, f"{mine:.1f}", f"{mine / theirs:.1f}", f"{100 * mine / roof:.1f} %"])
    header = [f"attack through {surrogate}", "pictures a second", "ratio", "share of the roof"]
    table = markdown_table(header, rows)
    return table + f"\nThe roof: the network's multiply-adds alone, in TF32: {roof:.0f} a second.\n"


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--attack", type=Path, metavar="RUN")
    parser.add_argument("--surrogate", default="resnet101")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    if not torch.cuda.is_available():
        sys.exit("gpu_peers: no GPU is visible here")
    if options.attack:
        text = compare_attack(options.attack, options.surrogate)
    else:
        text = compare_kernels(options.rounds)
    print(text)
    if options.out:
        options.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
