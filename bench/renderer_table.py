"""Score attacked objects in other renderers: run what is missing, write the page.

    scripts/renderer-table [RUN...] [--renderers NAME...] [--views N] [--light-steps N]
                           [--out FOLDER] [--report-only]

The page is docs/results-renderers.md. RUN is the folder of a finished run (default: the demo, and a
ball of scripts/method-table). The run's exported files are scored in each renderer from the same
cameras, without and with light. Then each run's object is attacked in a few steps, once with random
lights (`attack.eot.light`) and once without. Both are scored under Mitsuba's and MeshLab's light.

A finished evaluation is read, not run again. The page lists what is missing.
"""

import argparse
import json
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

import renderer_report
import run_folders
from method_plan import LITE0, ROOT, VICTIMS
from page import reading_of

RUNS = (ROOT / "runs/demo", ROOT / "runs/table/cells/methods/strong/soccer-ball-teapot")
RENDERERS = ("builtin", "mitsuba", "blender", "meshlab")
LIGHTS = ("0", "0.5")  # attack.eot.light
LIGHT_SAMPLES = "16"  # rays a pixel when the attacks with lights are scored
PICTURES = 2  # views in the side-by-side picture


@dataclass(frozen=True)
class Condition:
    """A renderer, lit or unlit."""

    renderer: str
    lit: bool

    @property
    def name(self) -> str:
        """The name used in file names."""
        return self.renderer + ("-lit" if self.lit else "")

    @property
    def options(self) -> list[str]:
        """The options for the program."""
        return ["--renderer", self.renderer, *(["--lit"] if self.lit else [])]


#: The conditions that score the attacks with and without lights.
LIGHT_SCORERS = tuple(Condition(*c) for c in (("builtin", False), ("mitsuba", True),
                                              ("meshlab", True)))  # fmt: skip


def conditions(renderers: tuple[str, ...]) -> list[Condition]:
    """Return the table's rows, unlit first; the built-in renderer has no lit row."""
    unlit = [Condition(r, False) for r in renderers]
    return unlit + [Condition(r, True) for r in renderers if r != "builtin"]


class Table:
    """The folder of the evaluations, and the program that fills it."""

    def __init__(self, out: Path, program: Path, views: int) -> None:
        """Store the paths."""
        self.out, self.program, self.views = out, program, views

    def record(self, run: Path, condition: Condition) -> Path:
        """Return the file of an evaluation."""
        return self.out / renderer_report.run_name(run) / f"{condition.name}.json"

    def finished(self, run: Path, condition: Condition) -> bool:
        """Return whether the evaluation exists for the present asset and number of views."""
        path = self.record(run, condition)
        if not path.is_file():
            return False
        record = json.loads(path.read_text(encoding="utf-8"))
        asset = run / "asset/adversarial.glb"
        return record["views"]["count"] == self.views and (
            record["asset_sha256"] == run_folders.sha256(asset)
        )

    def score(self, run: Path, condition: Condition) -> None:
        """Evaluate, and render the views of the side-by-side picture."""
        own = json.loads((run / "eval/builtin.json").read_text(encoding="utf-8"))
        out, asset = self.record(run, condition), run / "asset/adversarial.glb"
        out.parent.mkdir(parents=True, exist_ok=True)
        run_folders.tt3d(self.program, "render", asset, "--views", str(PICTURES),
                         *condition.options, "--out", out.with_suffix(""))  # fmt: skip
        run_folders.tt3d(self.program, "evaluate", asset, "--clean", run / "asset/clean.glb",
                         "--target", str(own["target"]["index"]),
                         "--true-class", str(own["true_class"]["index"]), "--victims", *VICTIMS,
                         "--views", str(self.views), *condition.options, "--out", out)  # fmt: skip

    def light_folder(self, run: Path, light: str, steps: int) -> Path:
        """Return the run folder of the attack with lights of this strength."""
        return self.out / f"light/{renderer_report.run_name(run)}-{light}-{steps}"

    def attack_with_light(self, run: Path, light: str, steps: int) -> None:
        """Attack the run's object with these lights, and score it unlit and lit."""
        folder = self.light_folder(run, light, steps)
        own = json.loads((run / "eval/builtin.json").read_text(encoding="utf-8"))
        target, true_class = (str(own[key]["index"]) for key in ("target", "true_class"))
        asset = folder / "asset/adversarial.glb"
        run_folders.share_object(run, folder)
        if not (folder / "attack/attack.safetensors").is_file():
            settings = (f"attack.steps={steps}", f"attack.eot.light={light}")
            run_folders.tt3d(self.program, "attack", folder, "--target", target,
                             "--surrogate", LITE0,
                             *(w for s in settings for w in ("--set", s)))  # fmt: skip
        if not asset.is_file():
            run_folders.tt3d(self.program, "bake", folder, "--set", "bake.resolution=1024")
        for condition in LIGHT_SCORERS:
            out = folder / f"eval/{condition.name}.json"
            # Lit clean accuracy is in the run's own records, so the clean pictures are not needed.
            clean = [] if condition.lit else ["--clean", folder / "asset/clean.glb"]
            samples = ["--samples", LIGHT_SAMPLES] if condition.lit else []
            if not out.is_file():
                run_folders.tt3d(self.program, "evaluate", asset, *clean, "--target", target,
                                 "--true-class", true_class, "--victims", *VICTIMS, "--views",
                                 str(self.views), *condition.options, *samples,
                                 "--out", out)  # fmt: skip


def parse_arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="*", type=Path, default=list(RUNS), metavar="RUN")
    parser.add_argument("--renderers", nargs="+", default=RENDERERS, choices=RENDERERS)
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--light-steps", type=int, default=150,
                        help="steps of the attacks with and without lights; 0: none")  # fmt: skip
    parser.add_argument("--out", type=Path, default=ROOT / "runs/renderers")
    parser.add_argument("--program", type=Path, default=ROOT / "build/release/tt3d")
    parser.add_argument("--page", type=Path, default=ROOT / "docs/results-renderers.md")
    parser.add_argument(
        "--report-only", action="store_true", help="run nothing, only write the page"
    )
    options = parser.parse_args()
    for run in options.runs:
        if not (run / "eval/builtin.json").is_file():
            parser.error(f"{run}: expected a finished run folder, with eval/builtin.json")
    return options


def fill(table: Table, run: Path, rows: list[Condition]) -> None:
    """Score a run in all renderers; a failure is printed and left out of the page."""
    for row in rows:
        if table.finished(run, row):
            continue
        start = time.monotonic()
        try:
            table.score(run, row)
            print(f"{run.name}, {row.name}: {time.monotonic() - start:.0f} s", flush=True)
        except subprocess.CalledProcessError as error:
            print(f"{run.name}, {row.name}: exit code {error.returncode}", flush=True)


def main() -> None:
    """Run the command line."""
    options = parse_arguments()
    table = Table(options.out.absolute(), options.program.absolute(), options.views)
    rows = conditions(tuple(options.renderers))
    if not options.report_only:
        for run in options.runs:
            fill(table, run, rows)
        for light in LIGHTS if options.light_steps else ():
            for run in options.runs:
                table.attack_with_light(run, light, options.light_steps)
    records = {run: {row: table.record(run, row) for row in rows if table.finished(run, row)}
               for run in options.runs}  # fmt: skip
    lights = {run: {light: [eval_ / f"{c.name}.json" for c in LIGHT_SCORERS
                            if (eval_ / f"{c.name}.json").is_file()]
                    for light in LIGHTS
                    for eval_ in [table.light_folder(run, light, options.light_steps) / "eval"]}
              for run in options.runs}  # fmt: skip
    reading = reading_of(options.page)
    text = renderer_report.page(records, lights, len(rows), options.light_steps, reading)
    options.page.write_text(text, encoding="utf-8")
    print(f"{sum(map(len, records.values()))} of {len(rows) * len(options.runs)}: {options.page}")


if __name__ == "__main__":
    main()
