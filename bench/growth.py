"""Plot the time of a step over pixels, faces, points and pictures, for docs/benchmarks.md.

scripts/bench growth [--threads N]
"""

import argparse
import json
import os
import statistics
import subprocess
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axis import Axis
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

ROOT = Path(__file__).resolve().parents[1]
BUILD = ROOT / "build/release/bench"
PICTURE = ROOT / "docs/images/growth.png"
BATCHES = (1, 2, 4, 8, 16, 32)
#: For each benchmark, the label of the axis and the content of a step.
KERNELS = {
    "growth_pixels": ("pixels a side", "49,928 faces drawn,\nforward and backward"),
    "growth_faces": ("faces", "400 x 400 pixels drawn,\nforward and backward"),
    "growth_points": ("points", "hash encoding and MLP,\nforward and backward"),
}


def kernel_times(name: str, threads: int) -> tuple[list[int], list[float]]:
    """Return sizes and milliseconds of a benchmark of kernel_bench.

    Each runs for two seconds, because the first call on a large picture also maps its memory.
    """
    done = subprocess.run(
        [BUILD / "kernel_bench", f"--benchmark_filter=^{name}/", "--benchmark_format=json",
         "--benchmark_min_time=2"],
        env={**os.environ, "OMP_NUM_THREADS": str(threads)},
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    runs = json.loads(done.stdout)["benchmarks"]
    return [int(r["name"].split("/")[1]) for r in runs], [r["real_time"] for r in runs]


def batch_times(threads: int) -> tuple[list[int], list[float]]:
    """Return batch sizes and milliseconds of EfficientNet-Lite0's passes."""
    times = []
    for batch in BATCHES:
        done = subprocess.run(
            [BUILD / "model_bench", ROOT / "models/efficientnet_lite0.pt2", str(batch),
             str(threads)],
            input="run\n" * 7, check=True, capture_output=True, text=True,
        )  # fmt: skip
        lines = [float(line) for line in done.stdout.split() if line != "ready"]
        times.append(1000 * statistics.median(lines[2:]))
    return list(BATCHES), times


def plain_ticks(axis: Axis) -> None:
    """Label a logarithmic axis in plain numbers: 1, 2, 5, 10 and so on; 1, 10 if it is long."""
    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1, 2, 5) if high < 500 * low else (1,), numticks=9))
    axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x / 1e6:g}M" if x >= 1e6 else (
        f"{x / 1e3:g}k" if x >= 1e3 else f"{x:g}")))  # fmt: skip
    axis.set_minor_locator(NullLocator())


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    every = parser.parse_args().threads
    figure, axes = plt.subplots(1, 4, figsize=(15, 3.6), layout="constrained")
    for threads in sorted({1, every}):
        label = f"{threads} thread{'s' if threads > 1 else ''}"
        for axis, (name, (x_label, title)) in zip(axes, KERNELS.items(), strict=False):
            axis.loglog(*kernel_times(name, threads), "o-", label=label)
            axis.set(xlabel=x_label, title=title)
        axes[3].loglog(*batch_times(threads), "o-", label=label)
    axes[3].set(xlabel="pictures", title="EfficientNet-Lite0,\nforward and backward")
    for axis in axes:
        axis.grid(alpha=0.3)
        plain_ticks(axis.xaxis)
        plain_ticks(axis.yaxis)
    axes[0].set_ylabel("milliseconds")
    axes[0].legend()
    figure.savefig(PICTURE, dpi=80)
    print(PICTURE)


if __name__ == "__main__":
    main()
