"""Load state dictionaries from files without executing anything in them."""

from collections.abc import Mapping
from pathlib import Path

import torch

CONTAINERS = ("state_dict_ema", "model_ema", "state_dict", "model_state_dict", "model")
PREFIXES = ("module.", "_orig_mod.", "model.", "net.")
LISTED = 8


class WeightsError(RuntimeError):
    """Weights are missing or do not fit; the message says what to do."""


def _read(path: Path) -> object:
    if not path.is_file():
        raise WeightsError(f"{path}: no such weights file")
    if path.suffix == ".safetensors":
        from safetensors.torch import load_file

        return load_file(path)
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        raise WeightsError(
            f"{path}: not a checkpoint of plain tensors ({str(error).splitlines()[0]}); "
            "save it again with torch.save(model.state_dict(), FILE) or as safetensors"
        ) from error


def read_state(path: Path) -> dict[str, torch.Tensor]:
    """Read a safetensors file or a checkpoint, and unpack the usual containers."""
    state = _read(path)
    for key in CONTAINERS:
        if isinstance(state, Mapping) and isinstance(state.get(key), Mapping):
            state = state[key]
    if not isinstance(state, Mapping):
        raise WeightsError(f"{path}: has a {type(state).__name__}, expected named tensors")
    tensors = {k: v for k, v in state.items() if isinstance(v, torch.Tensor)}
    if not tensors:
        raise WeightsError(f"{path}: has no tensors")
    return tensors


def strip_prefixes(state: dict[str, torch.Tensor], expected: set[str]) -> dict[str, torch.Tensor]:
    """Remove prefixes such as `module.` that every key has, until a key is an expected one."""
    changed = True
    while changed and not expected & set(state):
        changed = False
        for prefix in PREFIXES:
            if state and all(key.startswith(prefix) for key in state):
                state = {key[len(prefix) :]: value for key, value in state.items()}
                changed = True
    return state


def _listing(keys: list[str]) -> str:
    more = f" and {len(keys) - LISTED} more" if len(keys) > LISTED else ""
    return ", ".join(keys[:LISTED]) + more


def load_weights(model: torch.nn.Module, path: Path) -> None:
    """Load `path` into `model`; every key and shape must match, else the error lists them."""
    own = model.state_dict()
    state = strip_prefixes(read_state(path), set(own))
    missing = sorted(k for k in own if k not in state and not k.endswith("num_batches_tracked"))
    unknown = sorted(set(state) - set(own))
    shapes = [
        f"{k} {tuple(state[k].shape)} instead of {tuple(own[k].shape)}"
        for k in sorted(set(own) & set(state))
        if own[k].shape != state[k].shape
    ]
    problems = [
        f"{title}: {_listing(keys)}"
        for title, keys in (("missing", missing), ("unknown", unknown), ("wrong shape", shapes))
        if keys
    ]
    if problems:
        raise WeightsError(f"{path}: does not fit the network; " + "; ".join(problems))
    model.load_state_dict(state, strict=False)
