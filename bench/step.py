"""Measure the share of an attack step that is outside the classifier.

    scripts/bench step [--run RUN] [--rounds 5]

RUN is a run folder that has its mesh (default: runs/demo). The program step_bench attacks it with
the demo's settings and EfficientNet-Lite0 as the only surrogate. It times the steps and, inside
them, the classifier's forward and backward passes. This script rewrites its section of
docs/benchmarks.md.
"""

import argparse
import json
import os
import statistics
import subprocess
from pathlib import Path

from page import processor, write_section

ROOT = Path(__file__).resolve().parents[1]
PROGRAM = ROOT / "build/release/bench/step_bench"
CONFIG = ROOT / "configs/demo.toml"
SURROGATE = "efficientnet_lite0"
STEPS = 30  # a round


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--run", type=Path, default=ROOT / "runs/demo")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    if not (options.run / "mesh/mesh.safetensors").is_file():
        parser.error(f"{options.run} has no mesh; run scripts/demo first")
    rounds = []
    for _ in range(options.rounds):
        done = subprocess.run(
            [PROGRAM, CONFIG, options.run, ROOT / f"models/{SURROGATE}.pt2", str(STEPS),
             str(options.threads)],
            check=True, capture_output=True, text=True,
        )  # fmt: skip
        rounds.append(json.loads(done.stdout))
    step, classifier = (statistics.median(r[k] for r in rounds) for k in ("step", "classifier"))
    share = statistics.median(1 - r["classifier"] / r["step"] for r in rounds)
    text = (
        f"6 views a step, {SURROGATE}, {options.threads} threads of {processor()}, median of "
        f"{options.rounds} rounds of {STEPS} steps, load average {os.getloadavg()[0]:.1f} at the "
        f"end: a step takes {step:.0f} ms, the classifier's passes {classifier:.0f} ms; "
        f"{100 * share:.0f} % of the step is outside the classifier."
    )
    print(text)
    write_section("step", text)


if __name__ == "__main__":
    main()
