"""Test the table of renderers: its rows, its finished records, and its page."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "bench"))

Image = pytest.importorskip("PIL.Image")

import renderer_report  # noqa: E402
import renderer_table  # noqa: E402
import run_folders  # noqa: E402
from method_plan import VICTIMS  # noqa: E402
from renderer_table import Condition, Table, conditions  # noqa: E402


def make_run(folder: Path) -> Path:
    """Write the files of a finished run that the table reads."""
    (folder / "asset").mkdir(parents=True)
    (folder / "asset/adversarial.glb").write_bytes(b"an asset")
    config = {"attack.surrogates": ["efficientnet_lite0"]}
    (folder / "run.json").write_text(json.dumps({"config": config}))
    return folder


def write_record(
    path: Path, condition: Condition, asset: Path, asr: float, views: int = 20
) -> None:
    """Write the record of an evaluation and two pictures."""
    record = {
        "asset_sha256": run_folders.sha256(asset),
        "target": {"index": 849, "name": "teapot"},
        "true_class": {"index": 8, "name": "hen, biddy"},
        "renderer": {"name": condition.renderer, "version": "3.9.1", "lit": condition.lit},
        "views": {"count": views},
        "victims": [{"name": v, "asr": asr, "clean_accuracy": 0.85} for v in VICTIMS],
        "naturalness": {"psnr": 22.0, "ssim": 0.9},
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(record))
    pictures = path.with_suffix("") / "test"
    pictures.mkdir(parents=True)
    for view in range(2):
        Image.new("RGBA", (40, 40), (200, 10 * view, 0, 255)).save(pictures / f"r_{view}.png")


def test_conditions_are_every_renderer_unlit_and_lit_except_builtin() -> None:
    names = [c.name for c in conditions(("builtin", "mitsuba", "meshlab"))]
    assert names == ["builtin", "mitsuba", "meshlab", "mitsuba-lit", "meshlab-lit"]
    assert Condition("blender", True).options == ["--renderer", "blender", "--lit"]


def test_another_asset_or_number_of_views_is_not_finished(tmp_path: Path) -> None:
    run, row = make_run(tmp_path / "runs/demo"), Condition("mitsuba", True)
    table = Table(tmp_path / "out", tmp_path / "tt3d", 20)
    assert not table.finished(run, row)
    write_record(table.record(run, row), row, run / "asset/adversarial.glb", 0.5)
    assert table.finished(run, row)
    assert not table.finished(run, Condition("mitsuba", False))
    assert not Table(tmp_path / "out", tmp_path / "tt3d", 30).finished(run, row)
    (run / "asset/adversarial.glb").write_bytes(b"another asset")
    assert not table.finished(run, row)


def test_the_page_has_the_figures_and_lists_missing_records(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(renderer_report, "IMAGES", tmp_path)
    run = make_run(tmp_path / "runs/demo")
    table, done = Table(tmp_path / "out", tmp_path / "tt3d", 20), {}
    for renderer, lit, asr in (("builtin", False, 0.9), ("mitsuba", True, 0.25)):
        row = Condition(renderer, lit)
        done[row] = table.record(run, row)
        write_record(done[row], row, run / "asset/adversarial.glb", asr)
    write_record(run / "eval/builtin.json", row, run / "asset/adversarial.glb", 0.5)
    lights = {run: {"0": [], "0.5": list(done.values())}}
    page = renderer_report.page({run: done}, lights, 7, 150)
    assert "## Hen taken for teapot" in page and "Attacked through Lite0." in page
    assert "| built in | unlit | 90\\* (85) | 90 (85) |" in page
    assert "| Mitsuba 3.9.1 | lit | 25\\* (85) |" in page
    assert "| hen | 0.5 | Mitsuba, lit | 25\\* (85) |" in page
    assert "runs-demo: 2 of 7" in page
    sheet = Image.open(tmp_path / "renderers.jpg")
    side = renderer_report.PICTURE_SIDE
    assert sheet.size == (2 * side, 2 * side + renderer_report.LABEL_ROWS)
    assert sheet.getpixel((side // 2, side // 2))[0] > 180


def test_the_program_keeps_the_hand_written_section(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, page, row = make_run(tmp_path / "run"), tmp_path / "page.md", Condition("builtin", False)
    write_record(run / "eval/builtin.json", row, run / "asset/adversarial.glb", 0.5)
    page.write_text("# Old\n\nold table\n\n## What it says\n\n- kept\n")
    arguments = ["renderer_table.py", str(run), "--report-only", "--light-steps", "0"]
    arguments += ["--page", str(page), "--out", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", arguments)
    renderer_table.main()
    assert "\n## What it says\n\n- kept\n\n## Not run\n" in page.read_text()
    assert "old table" not in page.read_text()


def test_runs_with_the_same_name_have_different_folders(tmp_path: Path) -> None:
    table = Table(tmp_path, tmp_path / "tt3d", 20)
    row = Condition("builtin", False)
    assert table.record(Path("a/ball"), row) != table.record(Path("b/ball"), row)
