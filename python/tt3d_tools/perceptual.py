"""Measure LPIPS (Zhang et al., CVPR 2018) between pairs of pictures.

    python perceptual.py NET BACKBONE PAIRS.json OUT.json

NET is vgg, alex or squeeze. BACKBONE is a file with torchvision's weights of that network (.pth or
.safetensors, keys `features.N.weight`). The package lpips has the linear layers. PAIRS lists
[clean.png, adversarial.png, [left, top, right, bottom]], with the box around the object in pixels.
The result has the means over the pairs, of the whole frame and of the box.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

sys.path.insert(0, str(Path(__file__).resolve().parent))
import toolkit

if TYPE_CHECKING:
    import torch

SOURCES = {
    "vgg": "vgg16-397923af.pth",
    "alex": "alexnet-owt-7be5be79.pth",
    "squeeze": "squeezenet1_1-b8a52dc0.pth",
}
SMALLEST = 64  # smallest side in pixels that every backbone accepts


def backbone_weights(net: str, path: str) -> dict[str, torch.Tensor]:
    """Read a backbone's state dict; MissingTool says what to download and where to put it."""
    import torch

    file = Path(path)
    if not file.is_file():
        raise toolkit.MissingTool(
            f"LPIPS with {net} needs torchvision's weights {SOURCES[net]} (the '.pth' file of its "
            f"model zoo, ImageNet V1): download them to {path}"
        )
    if file.suffix == ".safetensors":
        from safetensors.torch import load_file

        return load_file(file)
    try:
        return torch.load(file, map_location="cpu", weights_only=True)
    except Exception as error:
        raise toolkit.InputProblem(f"{path}: not a readable state dict: {error}") from error


def load_lpips(net: str, path: str) -> torch.nn.Module:
    """Return the lpips package's network with the given backbone; nothing is downloaded."""
    lpips = toolkit.need_package("lpips", "--lpips")
    weights = backbone_weights(net, path)
    model = lpips.LPIPS(net=net, pretrained=True, pnet_rand=True, verbose=False).eval()
    # Each slice of the package's network names a layer by its number in torchvision.
    for name, value in model.net.state_dict().items():
        source = "features." + name.split(".", 1)[1]
        if source not in weights or weights[source].shape != value.shape:
            raise toolkit.InputProblem(
                f"{path}: no {source} of shape {tuple(value.shape)}; expected torchvision's {net}"
            )
        value.copy_(weights[source])
    return model


def picture(path: str) -> torch.Tensor:
    """Read a picture as [1,3,H,W] in [-1,1]."""
    import numpy as np
    import torch
    from PIL import Image

    array = np.asarray(Image.open(path).convert("RGB"), np.float32) / 127.5 - 1
    return torch.from_numpy(array).permute(2, 0, 1)[None]


def score(model: torch.nn.Module, pairs: list[list]) -> dict[str, float]:
    """Return the means over the pairs."""
    import torch

    frame, box = [], []
    with torch.inference_mode():
        for i, (clean, adversarial, (left, top, right, bottom)) in enumerate(pairs):
            a, b = picture(clean), picture(adversarial)
            frame.append(float(model(a, b)))
            rows, columns = slice(top, bottom), slice(left, right)
            a, b = a[:, :, rows, columns], b[:, :, rows, columns]
            if min(a.shape[2:]) < SMALLEST:
                size = [max(SMALLEST, n) for n in a.shape[2:]]
                a, b = (torch.nn.functional.interpolate(x, size, mode="bilinear") for x in (a, b))
            box.append(float(model(a, b)))
            toolkit.progress(i + 1, len(pairs))
    return {"lpips": sum(frame) / len(frame), "lpips_box": sum(box) / len(box)}


def work(arguments: list[str]) -> None:
    """Score the pairs of a file."""
    net, backbone, pairs, out = arguments
    if net not in SOURCES:
        raise toolkit.InputProblem(f"--lpips {net}: expected vgg, alex or squeeze")
    toolkit.need_package("torch", "--lpips")
    toolkit.need_package("torchvision", "--lpips")
    result = score(load_lpips(net, backbone), json.loads(Path(pairs).read_text()))
    Path(out).write_text(json.dumps(result))


if __name__ == "__main__":
    toolkit.main(work)
