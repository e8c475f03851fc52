"""Test the table of methods: its plan, its figures, and its page."""

import json
import sys
import threading
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "bench"))

np = pytest.importorskip("numpy")

import method_report  # noqa: E402
import method_table  # noqa: E402
from method_plan import ARCHITECTURES, METHODS, OBJECTS, OTHERS, Cell, plan  # noqa: E402
from method_table import Table, run_missing  # noqa: E402

ALL = (METHODS + OTHERS, tuple(OBJECTS))


def finish(folder: Path, asr: dict[str, float], budget: int = 1200) -> None:
    """Write the files of a finished attack."""
    record = {
        "victims": [{"name": name, "asr": value} for name, value in asr.items()],
        "views": {"count": 100},
        "naturalness": {"psnr": 22.0, "ssim": 0.9},
    }
    (folder / "eval").mkdir(parents=True)
    (folder / "eval/builtin.json").write_text(json.dumps(record))
    config = {"attack.steps": budget // 6, "attack.views_per_step": 6}
    (folder / "run.json").write_text(json.dumps({"config": config}))


def test_the_plan_has_every_cell_once_and_leaves_out_one_architecture() -> None:
    cells = plan(*ALL)
    assert len({c.name for c in cells}) == len(cells)
    assert {c.obj for c in cells} == set(OBJECTS)
    for cell in (c for c in cells if c.table == "leave-one-out"):
        left_out = cell.row.split(" without ")[1]
        assert not set(cell.surrogates) & set(ARCHITECTURES[left_out])
        assert len(cell.surrogates) == len(ARCHITECTURES) - 1


def test_the_plan_has_only_the_given_presets_and_objects() -> None:
    cells = plan(("mesh", "dual"), ("chicken",))
    assert {c.obj for c in cells} == {"chicken"}
    assert {c.method for c in cells} == {"mesh", "dual"}


def test_another_budget_is_another_attack(tmp_path: Path) -> None:
    cell = plan(("dual",), ("chicken",))[0]
    table = Table(tmp_path, tmp_path / "tt3d", 1200)
    assert not table.finished(cell)
    finish(table.folder(cell), dict.fromkeys(method_report.VICTIMS, 0.5))
    assert table.finished(cell)
    assert not Table(tmp_path, tmp_path / "tt3d", 600).finished(cell)


class Recorded(Table):
    """A table that records its calls; `together` attacks wait for each other, and `bad` fails."""

    def __init__(self, out: Path, together: int, bad: Cell | None = None) -> None:
        super().__init__(out, out / "tt3d", 1200)
        self.prepared: list[str] = []
        self.attacked: list[Cell] = []
        self.together, self.bad = threading.Barrier(together, timeout=20), bad

    def prepare(self, name: str) -> None:
        self.prepared.append(name)

    def run(self, cell: Cell) -> None:
        if cell == self.bad:
            raise RuntimeError(cell.name)
        self.together.wait()
        self.attacked.append(cell)


def test_attacks_run_in_parallel_and_each_object_is_prepared_once(tmp_path: Path) -> None:
    cells = plan(("dual", "texture"), ("chicken", "siamese-cat"))[:4]
    table = Recorded(tmp_path, together=2)  # an attack alone would wait until the timeout
    run_missing(table, cells, jobs=2, limit=60)
    assert sorted(c.name for c in table.attacked) == sorted(c.name for c in cells)
    assert table.prepared == list(dict.fromkeys(c.obj for c in cells))


def test_no_attack_begins_after_a_failure_or_the_limit(tmp_path: Path) -> None:
    cells = plan(("dual", "texture"), ("chicken", "siamese-cat"))[:4]
    failing = Recorded(tmp_path, together=1, bad=cells[1])
    with pytest.raises(RuntimeError, match=cells[1].name):
        run_missing(failing, cells, jobs=1, limit=60)
    assert failing.attacked == cells[:1]
    late = Recorded(tmp_path, together=1)
    run_missing(late, cells, jobs=2, limit=-1)
    assert late.attacked == []


def test_all_methods_of_a_table_run_the_surrogates_equally_often() -> None:
    shares: dict[str, set[int]] = {}
    for cell in plan(*ALL):
        a_step = 3 if cell.method == "strong" else 6 * len(cell.surrogates)
        asked = cell.steps(1200) * a_step
        assert 1200 * cell.share - 6 * len(cell.surrogates) < asked <= 1200 * cell.share
        shares.setdefault(cell.table, set()).add(cell.share)
    assert all(len(share) == 1 for share in shares.values())
    assert shares["methods"] == shares["other presets"] == shares["second target"] == {1}


def score(obj: str, share: float) -> method_report.Score:
    return method_report.Score(obj, {"a": share}, 100, 22.0, 0.9)


def test_the_interval_is_wide_if_objects_differ() -> None:
    same = method_report.interval([score(o, 0.5) for o in "xyz"], ("a",))
    apart = method_report.interval(
        [score(o, s) for o, s in zip("xyz", (0.1, 0.5, 0.9), strict=True)], ("a",)
    )
    assert same[0] == pytest.approx(0.5 - 1.96 * 0.5 / 300**0.5, abs=0.02)
    assert apart[0] < 0.2 and apart[1] > 0.8
    assert method_report.interval([score("x", 0.0)], ("a",)) == (0, 0)


def test_the_page_marks_surrogates_and_lists_missing_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(method_report, "IMAGES", tmp_path)
    cells = plan(("texture", "strong"), ("chicken",))
    first, left_out = cells[0], next(c for c in cells if c.table == "leave-one-out")
    done: dict[Cell, Path] = {}
    for cell, share in ((first, 0.25), (left_out, 0.75)):
        done[cell] = tmp_path / cell.name
        finish(done[cell], dict.fromkeys(method_report.VICTIMS, share))
    page = method_report.page(done, [c for c in cells if c not in done], 1200)
    assert "| `texture` | 1 | 25\\* | 25 | 25 | 25 | 25 | 25 | 25 (" in page
    assert "| `strong` | 75 (" in page
    assert f"{len(cells) - 2} attacks of the plan were not run" in page


def test_the_program_keeps_the_hand_written_section(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / "results.md"
    page.write_text("# Old\n\n## Methods\n\nold table\n\n## What it says\n\n- kept\n\n## Not run\n")
    arguments = ["method_table.py", "--report-only", "--page", str(page), "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", arguments)
    method_table.main()
    text = page.read_text()
    assert "\n## What it says\n\n- kept\n\n## Not run\n" in text
    assert "old table" not in text
    method_table.main()
    assert page.read_text() == text


def test_a_new_table_does_not_change_the_rest_of_the_page(tmp_path: Path) -> None:
    done: dict[Cell, Path] = {}
    for cell in (plan(*ALL)[0], next(c for c in plan(*ALL) if c.table == "leave-one-out")):
        done[cell] = tmp_path / cell.name
        finish(done[cell], dict.fromkeys(method_report.VICTIMS, 0.25))
    whole = method_report.page(done, [], 1200)
    again = {c: f for c, f in done.items() if c.table == "leave-one-out"}
    for folder in again.values():
        record = json.loads((folder / "eval/builtin.json").read_text())
        for victim in record["victims"]:
            victim["asr"] = 0.5
        (folder / "eval/builtin.json").write_text(json.dumps(record))
    page = method_report.renewed(whole, method_report.page(again, plan(*ALL)[:3], 1200))
    assert page.count("\n## ") == whole.count("\n## ")
    assert "| `texture` | 1 | 25\\*" in page
    assert "| `strong` | 50 (" in page
    assert "| `strong` | 25 (" not in page
    assert "Nothing of the plan is missing." in page
    assert method_report.renewed(whole, whole) == whole
