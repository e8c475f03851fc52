"""Test that memory stays within bounds if the set of models changes from step to step."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

pytest.importorskip("numpy")
sys.path.insert(0, str(Path(__file__).resolve().parent))
from tool_support import PROGRAM, ROOT, tt3d, write_asset

SHARED = ROOT.parent / "shared/data/models"
MODELS = [ROOT / f"models/efficientnet_lite{i}.pt2" for i in range(3)] + [
    SHARED / f"{name}.pt2" for name in ("mobilenet_v1", "hardnet39ds", "squeezenet1_1")
]
ABSENT = [path for path in MODELS if not path.exists()]

pytestmark = [
    pytest.mark.skipif(not PROGRAM.exists(), reason=f"{PROGRAM} is not built"),
    pytest.mark.skipif(bool(ABSENT), reason=f"models are absent: {[p.name for p in ABSENT]}"),
]


def peak_of(steps: int, asset: Path, run: Path) -> int:
    """Return the peak memory in bytes of an attack.

    Each of four views is shown to one of six models, so the set of models changes from step to
    step. Without a bound 200 steps take 2.4 times the memory of 50.
    """
    done = tt3d(
        "attack", run, "--asset", asset, "--target", "teapot", "--method", "strong", "--threads", 2,
        "--surrogate", *MODELS, "--set", f"attack.steps={steps}", "--set", "attack.epoch=0",
        "--set", "attack.views_per_step=4",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    stages = json.loads((run / "run.json").read_text())["stages"]
    return next(s["peak_rss_bytes"] for s in stages if s["name"] == "attack")


def test_memory_is_bounded_for_a_changing_mix_of_models(tmp_path: Path) -> None:
    asset = write_asset(tmp_path)
    first = peak_of(50, asset, tmp_path / "first")
    all_steps = peak_of(200, asset, tmp_path / "all")
    assert all_steps < 1.25 * first, f"{first >> 20} MiB after 50 steps, then {all_steps >> 20}"
