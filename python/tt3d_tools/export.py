"""Export model packages: `python -m tt3d_tools.export NAME... [--out models]`."""

import argparse
import importlib
import json
import subprocess
import sys
from pathlib import Path

import torch

from tt3d_tools.accuracy import measure
from tt3d_tools.package import ModelSpec, write_package
from tt3d_tools.weights import WeightsError, load_weights
from tt3d_tools.zoo import LITE_SIZES, NO_WEIGHTS, PAPER, build_named

ROOT = Path(__file__).resolve().parents[2]


def parse_labels(text: str) -> str | list[str]:
    """Return "imagenet-1k", the lines of a text file, or the strings of a JSON list."""
    if text == "imagenet-1k":
        return text
    path = Path(text)
    content = path.read_text(encoding="utf-8-sig")
    if path.suffix == ".json":
        return [str(label) for label in json.loads(content)]
    return [line.strip() for line in content.splitlines() if line.strip()]


def add_card_options(parser: argparse.ArgumentParser, required: bool) -> None:
    """Add the options for the values of a card that no table has."""
    parser.add_argument("--size", type=int, nargs="+", metavar="PX", required=required,
                        help="input size: H W, or one number")  # fmt: skip
    parser.add_argument("--mean", type=float, nargs=3, required=required)
    parser.add_argument("--std", type=float, nargs=3, required=required)
    parser.add_argument("--resize", type=int, help="shorter side before the crop (default: size)")
    parser.add_argument("--interpolation", choices=("bilinear", "bicubic"), default="bilinear")
    parser.add_argument(
        "--labels", default="imagenet-1k", help="imagenet-1k, or a file with the names"
    )
    parser.add_argument("--name", help="name of the package")
    parser.add_argument("--licence", default="unknown")
    parser.add_argument("--source", default="")


def build_own(target: str, options: argparse.Namespace) -> ModelSpec:
    """Import `module:function`, call it, and describe the network with the options."""
    if not (options.size and options.mean and options.std):
        raise WeightsError(f"{target}: a network of your own needs --size, --mean and --std")
    module, function = target.split(":", 1)
    sys.path.insert(0, "")
    try:
        model = getattr(importlib.import_module(module), function)()
    except (ImportError, AttributeError) as error:
        raise WeightsError(f"{target}: {error}; expected my_package.my_module:build") from error
    if options.weights and options.weights != NO_WEIGHTS:
        load_weights(model, Path(options.weights))
    height, width = (options.size * 2)[:2]
    return ModelSpec(
        name=options.name or module.rsplit(".", 1)[-1],
        model=model,
        architecture=type(model).__name__,
        source=options.source or target,
        licence=options.licence,
        input_size=(height, width),
        resize=options.resize or max(height, width),
        interpolation=options.interpolation,
        mean=tuple(options.mean),
        std=tuple(options.std),
        labels=parse_labels(options.labels),
    )


def build(target: str, options: argparse.Namespace) -> ModelSpec:
    """Build a model named on the command line."""
    if ":" in target and not target.startswith("timm:"):
        return build_own(target, options)
    spec = build_named(target, options.weights)
    spec.name = options.name or spec.name
    return spec


def check(program: Path, archive: Path) -> None:
    """Check the package with the C++ reader, if it is built."""
    if not program.is_file():
        print(f"not checked with the C++ reader: {program} is not built")
        return
    done = subprocess.run([program, "model", "check", archive], capture_output=True, text=True)
    if done.returncode != 0:
        raise WeightsError(f"{archive}: {program} refused it: {done.stderr.strip()}")
    print(done.stdout.strip())


def export_one(target: str, options: argparse.Namespace) -> None:
    """Build, measure, write and check one package."""
    torch.manual_seed(0)
    spec = build(target, options)
    if options.photos:
        spec.accuracy = measure(spec, Path(options.photos))
    archive, card = write_package(spec, Path(options.out), tuple(options.probe_batches))
    print(f"wrote {archive} ({archive.stat().st_size / 1e6:.1f} MB) and {card}")
    check(Path(options.program), archive)


def arguments() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(prog="python -m tt3d_tools.export", description=__doc__)
    parser.add_argument("models", nargs="*", metavar="NAME", help="see --list; timm:NAME; my:build")
    parser.add_argument("--out", default="models", help="folder to write to (default: models)")
    parser.add_argument("--weights", help="a weights file, or `none` for random weights")
    parser.add_argument("--list", action="store_true", help="print the known names")
    parser.add_argument("--photos", help="measure top-1 on a folder of photos named by WordNet id")
    parser.add_argument("--probe-batches", type=int, nargs="+", default=[2])
    parser.add_argument("--program", default=str(ROOT / "build/release/tt3d"))
    add_card_options(parser, required=False)
    return parser


def print_names() -> None:
    """Print every name that the exporter knows."""
    import torchvision

    print("\n".join(LITE_SIZES))
    others = [n for n in torchvision.models.list_models(torchvision.models) if n not in PAPER]
    print("\n".join((*PAPER, *others)))
    print("timm:NAME for any model of timm.list_models()")


def main() -> int:
    """Run the command line; return the exit code."""
    parser = arguments()
    options = parser.parse_args()
    if options.list:
        print_names()
        return 0
    if not options.models:
        parser.error("name at least one model, or --list")
    try:
        for target in options.models:
            export_one(target, options)
    except (WeightsError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
