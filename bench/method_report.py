"""The page of scripts/method-table: tables and plots of the finished attacks."""

import csv
import json
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from method_plan import (
    ARCHITECTURES,
    BETAS,
    ENSEMBLE_SHARE,
    LEFT_OUT_SHARE,
    LONGER_SHARE,
    METHODS,
    OTHERS,
    ROOT,
    SHORT,
    TARGETS,
    VICTIMS,
    Cell,
)
from page import READING, markdown_table, sections

IMAGES = ROOT / "docs/images"
BOOTSTRAPS = 2000
METHOD_ORDER = METHODS + OTHERS


@dataclass
class Score:
    """The evaluation of an attack; shares in [0,1]."""

    obj: str
    hits: dict[str, float]
    views: int
    psnr: float
    ssim: float


def read_score(cell: Cell, folder: Path) -> Score:
    """Read an attack's record."""
    record = json.loads((folder / "eval/builtin.json").read_text(encoding="utf-8"))
    natural = record["naturalness"]
    hits = {v["name"]: v["asr"] for v in record["victims"]}
    return Score(cell.obj, hits, record["views"]["count"], natural["psnr"], natural["ssim"])


def interval(scores: list[Score], victims: tuple[str, ...]) -> tuple[float, float]:
    """Return the 95 % interval of the mean success over objects and victims.

    It is a bootstrap clustered by object: objects are drawn with replacement, and the views of
    each of their attacks are drawn again from the observed success.
    """
    by_object = defaultdict(list)
    for score in scores:
        by_object[score.obj].append(score)
    clusters, random = list(by_object.values()), np.random.default_rng(0)
    means = []
    for _ in range(BOOTSTRAPS):
        drawn = [s for i in random.integers(len(clusters), size=len(clusters)) for s in clusters[i]]
        shares = [random.binomial(s.views, s.hits[v]) / s.views for s in drawn for v in victims]
        means.append(np.mean(shares))
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)


def mean(scores: list[Score], victims: tuple[str, ...]) -> float:
    """Return the mean success over attacks and victims."""
    return float(np.mean([s.hits[v] for s in scores for v in victims]))


def percent_with_interval(scores: list[Score], victims: tuple[str, ...]) -> str:
    """Return the mean success and its interval as text."""
    low, high = interval(scores, victims)
    return f"{100 * mean(scores, victims):.0f} ({100 * low:.0f} to {100 * high:.0f})"


class Results:
    """Finished attacks, by table and row."""

    def __init__(self, done: dict[Cell, Path]) -> None:
        """Read all records."""
        self.folders = done
        self.scores = {cell: read_score(cell, folder) for cell, folder in done.items()}

    def rows(self, table: str) -> dict[str, list[Cell]]:
        """Return a table's finished attacks by row: methods in the paper's order, then others."""
        rows = defaultdict(list)
        own = [cell for cell in self.scores if cell.table == table]
        order = {method: i for i, method in enumerate(METHOD_ORDER)}
        for cell in sorted(own, key=lambda c: order.get(c.row, 0)):
            rows[cell.row].append(cell)
        return rows

    def of(self, cells: list[Cell]) -> list[Score]:
        """Return the scores of attacks."""
        return [self.scores[c] for c in cells]

    def transfer_table(self, table: str) -> str:
        """Return success by method and victim; a star marks attacked models."""
        header = ["method", "attacks", *(SHORT[v] for v in VICTIMS), "unseen", "PSNR", "SSIM"]
        lines = []
        for row, cells in self.rows(table).items():
            scores, seen = self.of(cells), cells[0].surrogates
            unseen = tuple(v for v in VICTIMS if v not in seen)
            success = [
                f"{100 * mean(scores, (v,)):.0f}" + ("\\*" if v in seen else "") for v in VICTIMS
            ]
            lines.append(["`" + row + "`", str(len(cells)), *success,
                          percent_with_interval(scores, unseen),
                          f"{np.mean([s.psnr for s in scores]):.1f}",
                          f"{np.mean([s.ssim for s in scores]):.3f}"])  # fmt: skip
        return markdown_table(header, lines)

    def object_table(self, table: str) -> str:
        """Return the mean success on unseen models by row and object."""
        objects = sorted({c.obj for c in self.scores if c.table == table})
        lines = []
        for row, cells in self.rows(table).items():
            unseen = tuple(v for v in VICTIMS if v not in cells[0].surrogates)
            line = ["`" + row + "`"]
            for obj in objects:
                own = self.of([c for c in cells if c.obj == obj])
                line.append(f"{100 * mean(own, unseen):.0f}" if own else "not run")
            lines.append(line)
        return markdown_table(["method", *objects], lines)

    def left_out_table(self) -> str:
        """Return the success on the architecture left out, by method."""
        by_method = defaultdict(dict)
        for row, cells in self.rows("leave-one-out").items():
            method, left_out = row.split(" without ")
            by_method[method][left_out] = self.of(cells)
        lines = []
        for method, columns in by_method.items():
            line, means = ["`" + method + "`"], []
            for name, models in ARCHITECTURES.items():
                if name not in columns:
                    line.append("not run")
                    continue
                means.append(mean(columns[name], models))
                attacks = len(columns[name])
                line.append(f"{percent_with_interval(columns[name], models)}, {attacks} attacks")
            every = [s for scores in columns.values() for s in scores]
            of = "" if len(means) == len(ARCHITECTURES) else f" of {len(means)}"
            line += [f"{100 * np.mean(means):.0f}{of}", f"{np.mean([s.psnr for s in every]):.1f}"]
            lines.append(line)
        return markdown_table(["method", *ARCHITECTURES, "mean", "PSNR"], lines)


# ---- Plots --------------------------------------------------------------------------------


def _save(figure: object, name: str) -> str:
    import matplotlib.pyplot as plt

    figure.tight_layout()
    figure.savefig(IMAGES / name, dpi=110)
    plt.close(figure)
    return f"![{name.split('.')[0].replace('-', ' ')}](images/{name})\n"


def beta_plot(results: Results) -> str:
    """Plot success and PSNR against beta; return the Markdown of the picture."""
    import matplotlib.pyplot as plt

    rows = results.rows("beta")
    betas = [b for b in BETAS if f"beta {b}" in rows]
    scores = [results.of(rows[f"beta {b}"]) for b in betas]
    figure, axis = plt.subplots(figsize=(5.2, 3.2))
    for victims, label in (((VICTIMS[0],), "Lite0, attacked"), (VICTIMS[1:], "unseen models")):
        axis.semilogx(betas, [100 * mean(s, victims) for s in scores], marker="o", label=label)
    axis.set(xlabel="beta", ylabel="success, %", ylim=(0, 100))
    axis.legend(loc="lower center", bbox_to_anchor=(0.5, 1), ncols=2, frameon=False)
    other = axis.twinx()
    other.semilogx(betas, [np.mean([x.psnr for x in s]) for s in scores], "k--", marker="s")
    other.set_ylabel("PSNR, dB (dashed)")
    return _save(figure, "results-beta.png")


def curves_plot(results: Results) -> str:
    """Plot the objective of the dual attacks over the steps, smoothed over a tenth of them."""
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(5.2, 3.2))
    for cell in [*results.rows("methods")["dual"], *results.rows("longer").get("dual", [])]:
        text = (results.folders[cell] / "attack/curves.csv").read_text(encoding="utf-8")
        objective = np.array([float(r["objective"]) for r in csv.DictReader(text.splitlines())])
        width = max(1, len(objective) // 10)
        smooth = np.convolve(objective, np.ones(width) / width, mode="valid")
        label = f"{cell.obj}, {len(objective)} steps"
        axis.plot(np.arange(len(smooth)) + width, smooth, label=label)
    axis.set(xlabel="step", ylabel="objective (negative logit)")
    axis.legend(fontsize=7)
    return _save(figure, "results-curves.png")


# ---- Page ---------------------------------------------------------------------------------


def _missing(missing: list[Cell]) -> str:
    if not missing:
        return "Nothing of the plan is missing.\n"
    rows = defaultdict(list)
    for cell in missing:
        rows[f"{cell.table}, `{cell.row}`"].append(f"{cell.obj} to {cell.target}")
    lines = [f"- {row}: {', '.join(attacks)}" for row, attacks in rows.items()]
    return f"{len(missing)} attacks of the plan were not run:\n\n" + "\n".join(lines) + "\n"


def page(done: dict[Cell, Path], missing: list[Cell], budget: int, reading: str = "") -> str:
    """Return the page of these attacks and write its plots; `reading` is its hand-written part."""
    results = Results(done)
    parts = [INTRODUCTION.format(budget=budget, share=ENSEMBLE_SHARE)]
    if results.rows("methods"):
        parts += [THROUGH_LITE0, results.transfer_table("methods"), BY_OBJECT,
                  results.object_table("methods")]  # fmt: skip
    if results.rows("methods").get("dual"):
        parts += [CURVES, curves_plot(results)]
    if results.rows("longer"):
        parts += [LONGER.format(share=LONGER_SHARE), results.transfer_table("longer")]
    if results.rows("other presets"):
        parts += [OTHER_PRESETS, results.transfer_table("other presets")]
    if results.rows("second target"):
        parts += [SECOND_TARGET.format(target=TARGETS[1]), results.transfer_table("second target"),
                  BY_OBJECT, results.object_table("second target")]  # fmt: skip
    if results.rows("leave-one-out"):
        parts += [LEFT_OUT.format(share=LEFT_OUT_SHARE), results.left_out_table()]
    if results.rows("ensemble"):
        parts += [ENSEMBLE, results.transfer_table("ensemble")]
    if results.rows("beta"):
        parts += [BETA, results.transfer_table("beta"), beta_plot(results)]
    if reading:
        parts.append(f"## {READING}\n{reading}")
    return "\n".join([*parts, "## Not run\n", _missing(missing)])


def renewed(page: str, part: str) -> str:
    """Return `page` with its sections replaced by those of `part`, a page of some tables."""
    old, new = sections(page), sections(part)
    for heading, text in new.items():
        if heading not in ("", "Not run"):  # these refer to the whole plan
            old[heading] = text.rstrip("\n") + "\n"
    return "\n## ".join(old.values())


INTRODUCTION = """# Results

`scripts/method-table` writes the tables of this page. Run it again to continue, or after a
change. Every attack shows its surrogate {budget} pictures of 224 pixels. Several surrogates
together see {share} times as many, unless a table says otherwise. All other settings are those
of the preset ([attack](attack.md#methods)). Success is in %, on 100 held-out `dome` views of
the exported GLB on white, as a mean over the row's attacks; \\* marks models that were
attacked. The interval (95 %) is a bootstrap clustered by object. With three objects it is wide;
with one object it covers only the views.
"""
THROUGH_LITE0 = """## Methods

All attacks use EfficientNet-Lite0 as the only surrogate. "unseen" is the mean over the five
models that were not attacked.
"""
BY_OBJECT = "Mean success on the unseen models, by object:\n"
CURVES = "The objective of `dual` over its steps:\n"
LONGER = "## {share} times as many pictures\n\nOn one object, through EfficientNet-Lite0.\n"
OTHER_PRESETS = (
    "## Other presets\n\nOn one object. These presets serve other purposes than transfer.\n"
)
SECOND_TARGET = """## Another target: {target}

The settings of `strong` were chosen with this target and *vase* (decision 11), so its row here is
not independent of the tuning.
"""
LEFT_OUT = """## One architecture left out

The surrogates are one model of each of the three other architectures. The figure is the success
on the architecture left out (EfficientNet-Lite: mean of Lite0, 1 and 2). They see {share} times
as many pictures as a single surrogate, all together.
"""
ENSEMBLE = "## All four architectures as surrogates\n"
BETA = """## Beta

`dual` with its own objective (bare logits, where the paper has cross-entropy) and no floors: beta
alone sets the balance.
"""
