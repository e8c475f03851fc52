"""The page of scripts/renderer-table: success by renderer, pictures side by side, lights."""

import json
from pathlib import Path
from typing import Any

from method_plan import LITE0, ROOT, SHORT, VICTIMS
from page import READING, markdown_table

IMAGES = ROOT / "docs/images"
TITLES = {"builtin": "built in", "mitsuba": "Mitsuba", "blender": "Blender", "meshlab": "MeshLab"}
PICTURE_SIDE = 170  # pixels, of one view in the side-by-side picture
LABEL_ROWS = 18

Records = dict[Path, dict[Any, Path]]
Lights = dict[Path, dict[str, list[Path]]]  # evaluations by run and strength of the lights


def read(path: Path) -> dict[str, Any]:
    """Read a record."""
    return json.loads(path.read_text(encoding="utf-8"))


def run_name(run: Path) -> str:
    """Return the name of a run's evaluations; it includes the parent folder, to be unique."""
    return f"{run.parent.name}-{run.name}"


def first_name(record: dict[str, Any], key: str) -> str:
    """Return the first of a class's synonyms."""
    return record[key]["name"].split(",")[0]


def surrogates(run: Path) -> list[str]:
    """Return the models that a run attacked."""
    return read(run / "run.json")["config"]["attack.surrogates"]


def cells(record: dict[str, Any], seen: list[str]) -> list[str]:
    """Return success (clean accuracy) by victim, and the mean over those that were not attacked."""
    by_name = {v["name"]: v for v in record["victims"]}
    line = []
    for name in VICTIMS:
        victim = by_name[name]
        text = f"{100 * victim['asr']:.0f}" + ("\\*" if name in seen else "")
        if victim["clean_accuracy"] is not None:
            text += f" ({100 * victim['clean_accuracy']:.0f})"
        line.append(text)
    unseen = [by_name[v]["asr"] for v in VICTIMS if v not in seen]
    return [*line, f"{100 * sum(unseen) / len(unseen):.0f}" if unseen else "-"]


def renderer_title(record: dict[str, Any]) -> str:
    """Return a renderer's name and version; the built-in one has no version of its own."""
    renderer = record["renderer"]
    title = TITLES[renderer["name"]]
    return title if renderer["name"] == "builtin" else f"{title} {renderer['version']}"


def run_section(run: Path, by_condition: dict[Any, Path]) -> str:
    """Write a run's table."""
    seen, rows = surrogates(run), []
    for condition, path in by_condition.items():
        record = read(path)
        rows.append([renderer_title(record), "lit" if condition.lit else "unlit",
                     *cells(record, seen)])  # fmt: skip
    what = f"{first_name(record, 'true_class')} taken for {first_name(record, 'target')}"
    heading = f"## {what[0].upper()}{what[1:]}\n\n"
    through = ", ".join(SHORT[s] for s in seen)
    header = ["renderer", "light", *(SHORT[v] for v in VICTIMS), "unseen"]
    return f"{heading}Attacked through {through}.\n\n" + markdown_table(header, rows)


def light_section(lights: Lights, steps: int) -> str:
    """Write the table of attacks with and without lights."""
    rows = []
    for run, by_light in lights.items():
        name = first_name(read(run / "eval/builtin.json"), "true_class")
        for light, paths in by_light.items():
            for record in map(read, paths):
                psnr, lit = record["naturalness"]["psnr"], record["renderer"]["lit"]
                where = TITLES[record["renderer"]["name"]] + (", lit" if lit else ", unlit")
                quality = "" if psnr is None else f"{psnr:.1f}"
                rows.append([name, light, where, *cells(record, [LITE0]), quality])
    header = ["object", "`light`", "scored", *(SHORT[v] for v in VICTIMS), "unseen", "PSNR"]
    return LIGHT.format(steps=steps) + markdown_table(header, rows)


# ---- Side by side -------------------------------------------------------------------------


def side_by_side(records: Records, path: Path) -> None:
    """Write a picture of the runs' first views, a column for each renderer."""
    from PIL import Image, ImageDraw

    columns = max((list(r) for r in records.values()), key=len)
    rows = [(run, view) for run, done in records.items() if done for view in range(2)]
    size = (PICTURE_SIDE * len(columns), LABEL_ROWS + PICTURE_SIDE * len(rows))
    sheet = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(sheet)
    for x, column in enumerate(columns):
        light = "lit" if column.lit else "unlit"
        draw.text((PICTURE_SIDE * x + 6, 3), f"{TITLES[column.renderer]}, {light}", "black")
        for y, (run, view) in enumerate(rows):
            if column not in records[run]:
                continue
            file = records[run][column].with_suffix("") / f"test/r_{view}.png"
            picture = Image.open(file).convert("RGBA").resize((PICTURE_SIDE, PICTURE_SIDE))
            place = (PICTURE_SIDE * x, LABEL_ROWS + PICTURE_SIDE * y)
            sheet.paste(picture, place, picture)
    sheet.save(path, quality=88)


# ---- Page ---------------------------------------------------------------------------------


def page(records: Records, lights: Lights, asked: int, steps: int, reading: str = "") -> str:
    """Return the page of these evaluations and write its picture; `reading` is written by hand."""
    counts = {read(p)["views"]["count"] for done in records.values() for p in done.values()}
    views = " or ".join(map(str, sorted(counts))) or "no"
    parts = [INTRODUCTION.format(views=views)]
    parts += [run_section(run, done) for run, done in records.items() if done]
    if any(records.values()):
        side_by_side(records, IMAGES / "renderers.jpg")
        parts.append("![Two views of each object in every renderer](images/renderers.jpg)\n")
    if any(paths for by_light in lights.values() for paths in by_light.values()):
        parts.append(light_section(lights, steps))
    if reading:
        parts.append(f"## {READING}\n{reading}")
    short = {run: len(done) for run, done in records.items() if len(done) < asked}
    if short:
        lines = [f"- {run_name(run)}: {n} of {asked} rows are there" for run, n in short.items()]
        parts += ["## Not run\n", "\n".join(lines) + "\n"]
    return "\n".join(parts)


INTRODUCTION = """# Other renderers

`scripts/renderer-table` writes the tables of this page. Run it again to continue, or after a
change. Other programs render the exported GLB from the same {views} held-out `dome` views.
Success is in %, with the accuracy on the clean file in parentheses; \\* marks models that were
attacked, and "unseen" is the mean over the others. With 20 views, a figure is uncertain by
about 18 points each way. [Evaluation](evaluate.md#other-renderers) says what lit and unlit mean
in each program.
"""
LIGHT = """## Lights during the attack

Each object was attacked again, in {steps} steps with Lite0 as the only surrogate, without and
with random lights for each picture of the attack (`attack.eot.light`).

"""
