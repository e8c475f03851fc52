"""The probe of a model card: an input that anyone can compute, and the model's output for it.

The C++ reader (src/model/probe.cpp) computes the same input and compares the outputs.
"""

import contextlib
import math
from collections.abc import Iterator
from typing import Any
from unittest import mock

import numpy as np
import torch

RULE = "waves-1"


def probe_hash(index: np.ndarray, seed: int) -> np.ndarray:
    """Return a 32-bit hash of each index (the finaliser of MurmurHash3), as uint64."""
    mask = np.uint64(0xFFFFFFFF)
    h = (index.astype(np.uint64) + np.uint64(seed) * np.uint64(0x9E3779B9)) & mask
    for shift, factor in ((16, 0x85EBCA6B), (13, 0xC2B2AE35)):
        h ^= h >> np.uint64(shift)
        h = (h * np.uint64(factor)) & mask
    return h ^ (h >> np.uint64(16))


def probe_images(batch: int, height: int, width: int, seed: int) -> torch.Tensor:
    """Return the probe images [batch,3,height,width], float32 in [0,1].

    0.5 + 0.3 sin(2 pi (fx x / width + fy y / height) + n + c) + 0.3 (hash / 2^32 - 0.5), with
    fx = 2 + c + n, fy = 3 - c + n for image n, channel c, column x, row y, and the hash of the
    flat index; all in double, then rounded to float.
    """
    n, c, y, x = np.meshgrid(
        np.arange(batch), np.arange(3), np.arange(height), np.arange(width), indexing="ij"
    )
    phase = 2 * math.pi * ((2 + c + n) * x / width + (3 - c + n) * y / height) + n + c
    index = ((n * 3 + c) * height + y) * width + x
    noise = probe_hash(index, seed).astype(np.float64) / 2**32 - 0.5
    return torch.from_numpy((0.5 + 0.3 * np.sin(phase) + 0.3 * noise).astype(np.float32))


def gradient_positions(total: int, count: int, seed: int) -> list[int]:
    """Return `count` flat positions in a gradient of `total` elements."""
    return [int(h) % total for h in probe_hash(np.arange(count), seed + 1)]


def _rounded(values: torch.Tensor) -> list[float]:
    return [float(f"{v:.8g}") for v in values.double().flatten().tolist()]


def _affine_batch_norm(
    x: torch.Tensor,
    running_mean: torch.Tensor | None,
    running_var: torch.Tensor | None,
    weight: torch.Tensor | None = None,
    bias: torch.Tensor | None = None,
    training: bool = False,
    momentum: float = 0.1,
    eps: float = 1e-5,
) -> torch.Tensor:
    """Compute batch_norm in evaluation mode as a multiply-add."""
    if training or running_mean is None or running_var is None:
        return torch.batch_norm(
            x, weight, bias, running_mean, running_var, training, momentum, eps, False
        )
    scale = (running_var + eps).rsqrt() * (1 if weight is None else weight)
    shift = (0 if bias is None else bias) - running_mean * scale
    shape = (-1,) + (1,) * (x.dim() - 2)
    return x * scale.view(shape) + shift.view(shape)


@contextlib.contextmanager
def right_batch_norm(batch: int) -> Iterator[None]:
    """Work around a bug of torch 2.11 on the CPU at batch 1.

    There, the backward pass of batch_norm in evaluation mode is wrong for gradients whose strides
    could be channels-last.
    """
    if batch != 1:
        yield
        return
    with mock.patch.object(torch.nn.functional, "batch_norm", _affine_batch_norm):
        yield


def _probe_case(
    model: torch.nn.Module, card: dict[str, Any], batch: int, seed: int, positions: int
) -> dict[str, Any]:
    height, width = card["input_size"]
    images = probe_images(batch, height, width, seed).requires_grad_()
    mean = torch.tensor(card["mean"], dtype=torch.float32).view(1, 3, 1, 1)
    std = torch.tensor(card["std"], dtype=torch.float32).view(1, 3, 1, 1)
    with right_batch_norm(batch):
        logits = model((images - mean) / std)
    if logits.dim() == 3:  # a detector's [N,anchors,classes]: the highest score of each class
        logits = logits.amax(1)
    classes = logits.detach().argmax(1)
    (gradient,) = torch.autograd.grad(logits.gather(1, classes[:, None]).sum(), images)
    where = gradient_positions(gradient.numel(), positions, seed)
    return {
        "batch": batch,
        "logits": [_rounded(row) for row in logits.detach()],
        "classes": classes.tolist(),
        "gradient_norm": float(gradient.double().norm()),
        "gradient": _rounded(gradient.flatten()[where]),
    }


def make_probe(
    model: torch.nn.Module,
    card: dict[str, Any],
    batches: tuple[int, ...] = (2,),
    seed: int = 1,
    positions: int = 256,
) -> dict[str, Any]:
    """Run `model` (normalised input, logits) on the probe images; return the card's entry.

    `gradient` holds the derivative of the sum over the batch of logits[n, classes[n]] with
    respect to the images (before normalisation) at seeded flat positions.
    """
    cases = [_probe_case(model, card, batch, seed, positions) for batch in batches]
    return {"rule": RULE, "seed": seed, "cases": cases}
