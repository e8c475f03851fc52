"""Compare the attacks of the literature at equal budgets: run what is missing, write the page.

    scripts/method-table [--presets NAME...] [--objects NAME...] [--tables NAME...]
                         [--budget PASSES] [--out FOLDER] [--limit SECONDS] [--jobs COUNT]
                         [--report-only]

The page is docs/results.md. In all attacks the surrogates together see the same number of
pictures; several surrogates see twice as many as one. Each object is reconstructed once and shared.
A finished attack is read, not run again, and an interrupted one resumes. The page has the finished
attacks and lists the missing ones. --tables renews only the named sections of the page.
"""

import argparse
import json
import os
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import method_report
import run_folders
from method_plan import (
    CAPTURES,
    METHODS,
    OBJECTS,
    OTHERS,
    ROOT,
    TABLES,
    VICTIMS,
    Cell,
    plan,
    views_a_step,
)
from page import reading_of

SEED = 1
VIEWS = 100
RECORD = "eval/builtin.json"


class Table:
    """The folder of the attacks, and the program that fills it."""

    def __init__(self, out: Path, program: Path, budget: int) -> None:
        """Store the paths; `budget` is the number of pictures that one surrogate may see."""
        self.out, self.program, self.budget = out, program, budget

    def folder(self, cell: Cell) -> Path:
        """Return the cell's run folder."""
        return self.out / "cells" / cell.name

    def finished(self, cell: Cell) -> bool:
        """Return whether the cell has a record of an attack with this budget."""
        folder = self.folder(cell)
        if not (folder / RECORD).is_file():
            return False
        config = json.loads((folder / "run.json").read_text(encoding="utf-8"))["config"]
        return config["attack.steps"] == cell.steps(self.budget)

    def run(self, cell: Cell) -> None:
        """Attack, bake and score."""
        folder = self.folder(cell)
        run_folders.share_object(self._object(cell.obj), folder)
        settings = {
            "attack.steps": str(cell.steps(self.budget)),
            "attack.views_per_step": str(views_a_step(cell.method)),
            "bake.resolution": "1024",
            **cell.settings,
        }
        assignments = [
            word for key, value in settings.items() for word in ("--set", f"{key}={value}")
        ]
        self._tt3d("attack", folder, "--method", cell.method, "--target", cell.target,
                   "--surrogate", *cell.surrogates, *assignments, threads=1)  # fmt: skip
        self._tt3d("bake", folder, threads=1)
        self._tt3d("evaluate", folder / "asset/adversarial.glb", "--clean",
                   folder / "asset/clean.glb", "--target", cell.target, "--true-class",
                   OBJECTS[cell.obj], "--victims", *VICTIMS, "--views", str(VIEWS),
                   "--out", folder / RECORD, threads=1)  # fmt: skip

    def prepare(self, name: str) -> None:
        """Make the object's mesh if it is missing."""
        folder = self._object(name)
        if not (folder / "mesh/mesh.safetensors").is_file():
            self._tt3d("fit", CAPTURES / name, "--out", folder, "--seed", str(SEED))
            self._tt3d("mesh", folder)

    def _object(self, name: str) -> Path:
        return self.out / "objects" / name

    def _tt3d(self, *arguments: str | Path, threads: int = 0) -> None:
        run_folders.tt3d(self.program, *arguments, threads=threads)


def run_missing(table: Table, cells: list[Cell], jobs: int, limit: float) -> None:
    """Run the unfinished cells, `jobs` at once; start none after `limit` seconds.

    An attack uses one thread. Two attacks side by side finish sooner than two in sequence on two
    threads each, and the results do not depend on the machine's number of cores.
    """
    todo = [cell for cell in cells if not table.finished(cell)]
    for obj in dict.fromkeys(cell.obj for cell in todo):
        table.prepare(obj)
    end = time.monotonic() + limit
    stopped = threading.Event()  # set by a failure or Ctrl-C: no further attack starts

    def run(cell: Cell) -> None:
        start = time.monotonic()
        if start > end or stopped.is_set():
            return
        try:
            table.run(cell)
        except BaseException:
            stopped.set()
            raise
        took = time.monotonic() - start
        print(f"{todo.index(cell) + 1} of {len(todo)}: {cell.name}, {took:.0f} s", flush=True)

    with ThreadPoolExecutor(jobs) as pool:
        attacks = [pool.submit(run, cell) for cell in todo]
        try:
            for attack in attacks:
                attack.result()
        finally:
            stopped.set()


def parse_arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--presets", nargs="+", default=METHODS + OTHERS, metavar="NAME")
    parser.add_argument("--objects", nargs="+", default=tuple(OBJECTS), choices=OBJECTS)
    parser.add_argument("--tables", nargs="+", default=TABLES, choices=TABLES, metavar="NAME",
                        help="run and renew only these: " + ", ".join(TABLES))  # fmt: skip
    parser.add_argument("--budget", type=int, default=1200,
                        help="pictures that one surrogate sees in an attack")  # fmt: skip
    parser.add_argument("--out", type=Path, default=ROOT / "runs/table")
    parser.add_argument("--program", type=Path, default=ROOT / "build/release/tt3d")
    parser.add_argument("--page", type=Path, default=ROOT / "docs/results.md")
    parser.add_argument("--limit", type=float, default=float("inf"),
                        help="seconds after which no further attack starts")  # fmt: skip
    parser.add_argument("--jobs", type=int, default=min(os.cpu_count() or 1, 4),
                        help="attacks in parallel, each on one thread")  # fmt: skip
    parser.add_argument(
        "--report-only", action="store_true", help="run no attack, only write the page"
    )
    options = parser.parse_args()
    if options.budget < 100:
        parser.error("--budget: expected at least 100")
    if options.jobs < 1:
        parser.error("--jobs: expected at least 1")
    return options


def main() -> None:
    """Run the command line."""
    options = parse_arguments()
    whole = plan(tuple(options.presets), tuple(options.objects))
    cells = [cell for cell in whole if cell.table in options.tables]
    table = Table(options.out.absolute(), options.program.absolute(), options.budget)
    if not options.report_only:
        run_missing(table, cells, options.jobs, options.limit)
    done = {cell: table.folder(cell) for cell in cells if table.finished(cell)}
    missing = [cell for cell in cells if cell not in done]
    page = method_report.page(done, missing, options.budget, reading_of(options.page))
    if len(cells) < len(whole) and options.page.is_file():
        page = method_report.renewed(options.page.read_text(encoding="utf-8"), page)
    options.page.write_text(page, encoding="utf-8")
    print(f"{len(done)} of {len(cells)} attacks: {options.page}")


if __name__ == "__main__":
    main()
