"""Measure top-1 and top-5 accuracy of a network on photographs named by WordNet id."""

from pathlib import Path

import numpy as np
import torch
from PIL import Image

from tt3d_tools.package import ModelSpec
from tt3d_tools.weights import WeightsError

WNIDS = Path(__file__).resolve().parents[2] / "data" / "imagenet1k.tsv"


def load_picture(path: Path, spec: ModelSpec) -> np.ndarray:
    """Read, resize and crop a photograph by the card's rule, with Pillow; [H,W,3] in [0,1]."""
    height, width = spec.input_size
    image = Image.open(path).convert("RGB")
    short, filters = min(image.size), Image.Resampling
    size = tuple(spec.resize if s == short else int(spec.resize * s / short) for s in image.size)
    image = image.resize(size, getattr(filters, spec.interpolation.upper()))
    left, top = round((size[0] - width) / 2), round((size[1] - height) / 2)
    return np.asarray(image.crop((left, top, left + width, top + height)), np.float32) / 255


def _pictures(folder: Path) -> list[tuple[Path, int]]:
    lines = WNIDS.read_text(encoding="utf-8").splitlines()
    index = {line.split("\t")[1]: int(line.split("\t")[0]) for line in lines}
    found = [(p, index[p.stem]) for p in sorted(folder.iterdir()) if p.stem in index]
    if not found:
        raise WeightsError(f"{folder}: has no photographs named by WordNet id")
    return found


def measure(spec: ModelSpec, folder: Path, batch: int = 16) -> dict[str, float | int | None]:
    """Return top1, top5 and n (the number of photographs) of an ImageNet-1k network."""
    pictures = _pictures(folder)
    model = spec.model.eval()
    mean, std = (torch.tensor(v).view(1, 3, 1, 1) for v in (spec.mean, spec.std))
    hits = torch.zeros(2)
    with torch.inference_mode():
        for start in range(0, len(pictures), batch):
            part = pictures[start : start + batch]
            images = np.stack([load_picture(path, spec) for path, _ in part])
            logits = model((torch.from_numpy(images).permute(0, 3, 1, 2) - mean) / std)
            truth = torch.tensor([[label] for _, label in part])
            correct = logits.topk(5).indices == truth
            hits += torch.stack([correct[:, 0].sum(), correct.any(1).sum()])
    top1, top5 = (round(float(h) / len(pictures), 4) for h in hits)
    return {"top1": top1, "top5": top5, "n": len(pictures)}
