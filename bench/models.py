"""Compare classifiers in tt3d with PyTorch's eager mode, forward and backward.

    scripts/bench models [--batch 8] [--threads N] [--pairs 15] [--loading] [NAME...]

Machine, threads, batch and network (random weights) are the same. A pair is one run of each, in
direct succession; its ratio is little affected by other load on the machine. The program rewrites
its sections of docs/benchmarks.md.
"""

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import torch
from page import write_section

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "python"))

from tt3d_tools.package import write_package  # noqa: E402
from tt3d_tools.zoo import build_named  # noqa: E402

NAMES = (
    "efficientnet_lite0", "mobilenet_v2", "efficientnet_b0", "resnet50", "densenet121",
    "inception_v3", "vgg16", "vit_b_16", "swin_t", "convnext_tiny",
)  # fmt: skip
PACKAGES = ROOT / "build/bench/models"
BUILD = ROOT / "build/release"
WARM_UP = 2
LOADS = 7


@dataclass
class Row:
    """Median seconds of a run, and the median over the pairs of C++ over eager."""

    name: str
    eager: float
    cpp: float
    ratio: float


class Worker:
    """The C++ side: a process that runs one pass for each line sent to it."""

    def __init__(self, archive: Path, batch: int, threads: int) -> None:
        """Start the process and wait until it has loaded the package."""
        command = [BUILD / "bench/model_bench", archive, str(batch), str(threads)]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        self._line()

    def run(self) -> float:
        """Return the seconds of one forward and backward pass."""
        self.process.stdin.write("run\n")
        return float(self._line())

    def close(self) -> None:
        """End the process."""
        self.process.stdin.close()
        self.process.wait()

    def _line(self) -> str:
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError("model_bench ended early")
        return line


class Eager:
    """PyTorch's side: the network that torchvision or timm builds."""

    def __init__(self, network: torch.nn.Module, size: tuple[int, int], batch: int) -> None:
        """Store the network and make a batch of noise."""
        self.network = network.eval().requires_grad_(False)
        self.images = torch.rand(batch, 3, *size)

    def run(self) -> float:
        """Return the seconds of one forward and backward pass."""
        start = time.perf_counter()
        leaf = self.images.detach().requires_grad_()
        loss = -self.network((leaf - 0.45) / 0.225).log_softmax(1)[:, 0].mean()
        torch.autograd.grad(loss, leaf)
        return time.perf_counter() - start


def package(name: str) -> tuple[Path, torch.nn.Module, tuple[int, int]]:
    """Return archive, network and input size of a network with random weights."""
    torch.manual_seed(0)
    spec = build_named(name, "none")
    archive = PACKAGES / f"{spec.name}.pt2"
    if not archive.with_suffix(".json").is_file():
        write_package(spec, PACKAGES)
    return archive, spec.model, spec.input_size


def compare(name: str, options: argparse.Namespace) -> Row:
    """Run one network on both sides, in alternation."""
    archive, network, size = package(name)
    eager = Eager(network, size, options.batch)
    worker = Worker(archive, options.batch, options.threads)
    for _ in range(WARM_UP):
        eager.run(), worker.run()
    pairs = [(eager.run(), worker.run()) for _ in range(options.pairs)]
    worker.close()
    ratio = statistics.median(cpp / other for other, cpp in pairs)
    return Row(name, statistics.median(p[0] for p in pairs),
               statistics.median(p[1] for p in pairs), ratio)  # fmt: skip


def loading() -> dict[str, float]:
    """Return seconds (best of several) and memory of loading ResNet-101."""
    archive, _, _ = package("resnet101")
    result = {}
    for label, extra in (("probe", []), ("read", ["--no-probe"])):
        command = [BUILD / "tt3d", "model", "check", archive, "--json", *extra]
        runs = [json.loads(subprocess.check_output(command)) for _ in range(LOADS)]
        result[f"{label}_seconds"] = min(run["load_seconds"] for run in runs)
        growth = statistics.median(run["load_peak_bytes"] for run in runs)
        result[f"{label}_memory"] = growth / runs[0]["archive_bytes"]
    return result


def loading_text() -> str:
    """Measure loading ResNet-101; returns the text between its marks."""
    load = loading()
    return (
        f"Loading ResNet-101 (180 MB), best of {LOADS}, load average {os.getloadavg()[0]:.1f} at "
        f"the end: {load['probe_seconds']:.2f} s and {load['probe_memory']:.2f} times the "
        f"archive's size at its peak, to read, check SHA-256 and CRC, fold, and compare the "
        f"probe's logits; without the probe {load['read_seconds']:.2f} s and "
        f"{load['read_memory']:.2f} times. The probe's gradients are compared before the first "
        f"gradient is asked for."
    )


def section(rows: list[Row], options: argparse.Namespace) -> str:
    """Return the text between the marks."""
    cores = os.cpu_count()
    lines = [
        f"Batch {options.batch}, {options.threads} threads, {options.pairs} pairs, torch "
        f"{torch.__version__.split('+')[0]}, {platform.machine()} with {cores} cores, load average "
        f"{os.getloadavg()[0]:.1f} at the end:",
        "",
        "| network | PyTorch eager, ms an image | tt3d, ms an image | tt3d / eager |",
        "|---|---|---|---|",
    ]
    for row in rows:
        each = 1000 / options.batch
        lines.append(f"| {row.name} | {row.eager * each:.1f} | {row.cpp * each:.1f} "
                     f"| {row.ratio:.2f} |")  # fmt: skip
    return "\n".join(lines)


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=NAMES)
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--pairs", type=int, default=15)
    parser.add_argument("--loading", action="store_true", help="measure only loading")
    options = parser.parse_args()
    if options.loading:
        options.names = ()
    torch.set_num_threads(options.threads)
    rows = []
    for name in options.names:
        rows.append(compare(name, options))
        print(f"{name}: tt3d / eager = {rows[-1].ratio:.2f}", flush=True)
    if rows:
        print(section(rows, options))
    if tuple(options.names) == NAMES:
        write_section("models", section(rows, options))
    if options.loading or tuple(options.names) == NAMES:
        write_section("loading", loading_text())


if __name__ == "__main__":
    main()
