"""LPIPS (Zhang et al., CVPR 2018) between pairs of pictures, for tt3d.

    python perceptual.py NET BACKBONE PAIRS.json OUT.json

NET is vgg, alex or squeeze; BACKBONE a file with torchvision's weights of that network (.pth or
.safetensors, keys `features.N.weight`); the linear layers come with the package lpips. PAIRS lists
[clean.png, adversarial.png, [left, top, right, bottom]]: the box in pixels around the object. The
result has the means over the pairs of the whole frame and of the box.
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
SMALLEST = 64  # pixels a side that every backbone can take


def backbone_weights(net: str, path: str) -> dict[str, torch.Tensor]:
    """The state dict of a backbone; MissingTool says what to download where."""
    import torch

    file = Path(path)
    if not file.is_file():
        raise toolkit.MissingTool(
            f"LPIPS with {net} needs torchvision's weights {SOURCES[net]} (its 'pth' file of the "
            f"model zoo, ImageNet V1): download them and put them at {path}"
        )
    if file.suffix == ".safetensors":
        from safetensors.torch import load_file

        return load_file(file)
    try:
        return torch.load(file, map_location="cpu", weights_only=True)
    except Exception as error:
        raise toolkit.InputProblem(f"{path}: no state dict that can be read: {error}") from error


def load_lpips(net: str, path: str) -> torch.nn.Module:
    """The lpips package's network with a given backbone; nothing is downloaded."""
    lpips = toolkit.need_package("lpips", "--lpips")
    weights = backbone_weights(net, path)
    model = lpips.LPIPS(net=net, pretrained=True, pnet_rand=True, verbose=False).eval()
    # Slice k of the package's network holds torchvision's layer N under its number.
    for name, value in model.net.state_dict().items():
        source = "features." + name.split(".", 1)[1]
        if source not in weights or weights[source].shape != value.shape:
            raise toolkit.InputProblem(
                f"{path}: no {source} of shape {tuple(value.shape)}; expected torchvision's {net}"
            )
        value.copy_(weights[source])
    return model


def picture(path: str) -> torch.Tensor:
    """[1,3,H,W] in [-1,1]."""
    import numpy as np
    import torch
    from PIL import Image

    array = np.asarray(Image.open(path).convert("RGB"), np.float32) / 127.5 - 1
    return torch.from_numpy(array).permute(2, 0, 1)[None]


def score(model: torch.nn.Module, pairs: list[list]) -> dict[str, float]:
    """Means over the pairs."""
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
    """Scores the pairs of a file."""
    net, backbone, pairs, out = arguments
    if net not in SOURCES:
        raise toolkit.InputProblem(f"--lpips {net}: expected vgg, alex or squeeze")
    toolkit.need_package("torch", "--lpips")
    toolkit.need_package("torchvision", "--lpips")
    result = score(load_lpips(net, backbone), json.loads(Path(pairs).read_text()))
    Path(out).write_text(json.dumps(result))


if __name__ == "__main__":
    toolkit.main(work)
