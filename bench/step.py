"""The share of an attack step that is not the classifier.

    scripts/bench step [--run RUN] [--rounds 5]

Times the attack of the demo's setting on a run that has its mesh (default: runs/demo), through
EfficientNet-Lite0 alone, and the classifier's forward and backward pass on as many pictures, in
turns. A step is the difference between a long and a short attack, so that loading does not count.
Rewrites the section between the marks in docs/benchmarks.md.
"""

import argparse
import json
import os
import statistics
import subprocess
import tempfile
from pathlib import Path

from page import write_section

ROOT = Path(__file__).resolve().parents[1]
BUILD = ROOT / "build/release"
SURROGATE = "efficientnet_lite0"
VIEWS = 6  # attack.views_per_step
SHORT, LONG = 8, 32


def attack_seconds(run: Path, steps: int) -> float:
    """Return the seconds of the attack stage with this many steps."""
    with tempfile.TemporaryDirectory(dir=run.parent) as folder:
        copy = Path(folder) / "run"
        copy.mkdir()
        for part in ("field", "mesh"):
            (copy / part).symlink_to(run / part)
        record = json.loads((run / "run.json").read_text(encoding="utf-8"))
        record["stages"] = [s for s in record["stages"] if s["name"] in ("field", "mesh")]
        (copy / "run.json").write_text(json.dumps(record), encoding="utf-8")
        subprocess.run(
            [BUILD / "tt3d", "attack", copy, "--target", "teapot", "--surrogate", SURROGATE,
             "--set", f"attack.steps={steps}", "-q"],
            check=True, capture_output=True,
        )  # fmt: skip
        stages = json.loads((copy / "run.json").read_text(encoding="utf-8"))["stages"]
        return next(s["seconds"] for s in stages if s["name"] == "attack")


def classifier_seconds(threads: int) -> float:
    """Return the median seconds of the classifier's passes on the pictures of a step."""
    archive = ROOT / f"models/{SURROGATE}.pt2"
    done = subprocess.run(
        [BUILD / "bench/model_bench", archive, str(VIEWS), str(threads)],
        input="run\n" * LONG, check=True, capture_output=True, text=True,
    )  # fmt: skip
    times = [float(line) for line in done.stdout.split() if line != "ready"]
    return statistics.median(times[LONG // 4 :])


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--run", type=Path, default=ROOT / "runs/demo")
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    if not (options.run / "mesh/mesh.safetensors").is_file():
        parser.error(f"{options.run} has no mesh; run scripts/demo first")
    threads, run = os.cpu_count() or 1, options.run.resolve()
    steps, classifier = [], []
    for _ in range(options.rounds):
        short, long = attack_seconds(run, SHORT), attack_seconds(run, LONG)
        steps.append((long - short) / (LONG - SHORT))
        classifier.append(classifier_seconds(threads))
    share = statistics.median(1 - c / s for s, c in zip(steps, classifier, strict=True))
    text = (
        f"{VIEWS} views a step, {SURROGATE}, {threads} threads, median of {options.rounds} rounds, "
        f"load average {os.getloadavg()[0]:.1f} at the end: a step takes "
        f"{1000 * statistics.median(steps):.0f} ms, the classifier's passes "
        f"{1000 * statistics.median(classifier):.0f} ms; {100 * share:.0f} % of the step is "
        f"outside the classifier."
    )
    print(text)
    write_section("step", text)


if __name__ == "__main__":
    main()
