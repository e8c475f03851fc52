"""Write the section "CUDA" of docs/benchmarks.md from the results of scripts/gpu-check.

python bench/gpu_report.py --gpu NAME --operators FILE [--run OPTIONS=RUN_DIR]...
    [--peers FILE...]
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path

from page import markdown_table, write_section


def demo_row(options: str, folder: Path) -> list[str]:
    """Return the row of a demo run."""
    run = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    record = json.loads((folder / "eval/builtin.json").read_text(encoding="utf-8"))
    field = json.loads((folder / "field/metrics.json").read_text(encoding="utf-8"))
    asset = json.loads((folder / "asset/metrics.json").read_text(encoding="utf-8"))
    seconds = sum(s["seconds"] for s in run["stages"])
    stages = ", ".join(f"{s['name']} {s['seconds']:.0f}" for s in run["stages"])
    rates = ", ".join(f"{v['name']} {100 * v['asr']:.0f} %" for v in record["victims"])
    psnr = f"{field['psnr_test']:.2f} dB, {asset['psnr_test']:.2f} dB"
    return [f"`{options}`", f"{seconds:.0f} s ({stages})", rates, psnr]


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gpu", required=True, help="name and driver, as nvidia-smi prints them")
    parser.add_argument(
        "--cores", type=int, default=os.cpu_count(), help="CPU cores of the machine"
    )
    parser.add_argument("--operators", type=Path, required=True, help="the output of gpu_speed")
    parser.add_argument("--run", action="append", default=[], metavar="OPTIONS=RUN_DIR")
    parser.add_argument(
        "--peers", type=Path, nargs="*", default=[], help="the output of gpu_peers.py"
    )
    options = parser.parse_args()
    parts = [
        f"Measured by `scripts/gpu-check` on: {options.gpu}; {options.cores} CPU cores.",
        options.operators.read_text(encoding="utf-8").strip(),
        *(peers.read_text(encoding="utf-8").strip() for peers in options.peers),
    ]
    if options.run:
        rows = [demo_row(name, Path(path)) for name, path in (r.split("=", 1) for r in options.run)]
        head = ["demo with", "stages, s", "ASR on held-out views", "PSNR of field and baked mesh"]
        parts.append(markdown_table(head, rows).strip())
    write_section("gpu-check", "\n\n".join(parts))


if __name__ == "__main__":
    main()
