"""Write a model package: NAME.pt2 (torch.export archive) and NAME.json (card)."""

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from tt3d_tools.probe import make_probe
from tt3d_tools.weights import WeightsError

MAX_BATCH = 4096
SCORES = ("softmax", "sigmoid", "none")


@dataclass
class ModelSpec:
    """A network and the values of its card."""

    name: str
    model: torch.nn.Module
    architecture: str
    source: str
    licence: str
    input_size: tuple[int, int]
    resize: int
    interpolation: str
    mean: tuple[float, float, float]
    std: tuple[float, float, float]
    labels: str | list[str] = "imagenet-1k"
    label_set: str = ""
    scores: str | None = None
    accuracy: dict[str, float | int | None] = field(
        default_factory=lambda: {"top1": None, "top5": None, "n": None}
    )


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file as hex."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def check_unit_range(mean: Sequence[float], std: Sequence[float]) -> None:
    """Raise WeightsError if mean or std belong to pictures with values in [0,255]."""
    if max(abs(value) for value in (*mean, *std)) <= 2:
        return
    divided = [" ".join(f"{value / 255:.6g}" for value in values) for values in (mean, std)]
    raise WeightsError(
        "--mean and --std are for pictures in [0,255], expected values for pictures in [0,1]; "
        f"divide both by 255: --mean {divided[0]} --std {divided[1]}"
    )


def score_keys(label_set: str, scores: str | None) -> dict[str, str]:
    """Return the optional keys of a card that are set."""
    return {k: v for k, v in (("label_set", label_set), ("scores", scores)) if v}


def check_logits(name: str, probe: dict[str, Any], scores: str | None) -> None:
    """Raise WeightsError if the outputs are probabilities and the card does not say so."""
    logits = torch.tensor(probe["cases"][0]["logits"])
    if scores == "none" or logits.min() < 0 or logits.max() > 1:
        return
    if torch.allclose(logits.sum(1), torch.ones(len(logits)), atol=1e-4):
        raise WeightsError(
            f"{name}: gives probabilities, expected logits; remove its softmax, or say so with "
            "--scores none"
        )


def card_of(spec: ModelSpec) -> dict[str, Any]:
    """Return the card of `spec` without checksum and probe."""
    return {
        "name": spec.name,
        "architecture": spec.architecture,
        "source": spec.source,
        "licence": spec.licence,
        "input_size": list(spec.input_size),
        "resize": spec.resize,
        "interpolation": spec.interpolation,
        "mean": list(spec.mean),
        "std": list(spec.std),
        "labels": spec.labels,
        **score_keys(spec.label_set, spec.scores),
        "parameters": sum(p.numel() for p in spec.model.parameters()),
        **spec.accuracy,
    }


def export_program(model: torch.nn.Module, size: tuple[int, int]) -> torch.export.ExportedProgram:
    """Export an evaluation-mode network for float32 [N,3,H,W] with a dynamic batch."""
    sample = torch.zeros(2, 3, *size)
    batch = torch.export.Dim("batch", min=1, max=MAX_BATCH)
    program = torch.export.export(model, (sample,), dynamic_shapes=({0: batch},), strict=False)
    program.example_inputs = None  # they are zeros, and stored as a pickle
    for node in program.graph.nodes:
        node.meta.pop("stack_trace", None)  # a package must not have paths of this machine
    return program


def write_text_atomic(path: Path, text: str) -> None:
    """Write through a temporary file in the same folder, so that `path` is always complete."""
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    with os.fdopen(handle, "w", encoding="utf-8") as stream:
        stream.write(text)
        stream.flush()
        os.fsync(stream.fileno())
    os.chmod(temporary, 0o644)
    os.replace(temporary, path)


def card_text(card: dict[str, Any]) -> str:
    """Return the card as JSON with one line for each key."""
    lines = [f" {json.dumps(key)}: {json.dumps(value)}" for key, value in card.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def write_package(
    spec: ModelSpec, out: Path, probe_batches: tuple[int, ...] = (2,)
) -> tuple[Path, Path]:
    """Export `spec` into folder `out`; return the paths of archive and card.

    The card is written last, so a card always belongs to a complete archive.
    """
    out.mkdir(parents=True, exist_ok=True)
    model = spec.model.eval().requires_grad_(False)
    card = card_of(spec)
    archive, card_path = out / f"{spec.name}.pt2", out / f"{spec.name}.json"
    with torch.enable_grad():
        probe = make_probe(model, card, probe_batches)
    check_logits(spec.name, probe, spec.scores)
    program = export_program(model, spec.input_size)
    folder = Path(tempfile.mkdtemp(prefix=f".{spec.name}.", dir=out))
    try:
        temporary = folder / archive.name
        torch.export.save(program, temporary)
        card["sha256"] = file_sha256(temporary)
        card_path.unlink(missing_ok=True)
        os.replace(temporary, archive)
    finally:
        shutil.rmtree(folder)
    write_text_atomic(card_path, card_text({**card, "probe": probe}))
    return archive, card_path
