"""Write a card for an archive that someone else exported.

`python -m tt3d_tools.card FILE.pt2 --mean ... --std ... --size ...`. Python does not open the
archive, because its sample inputs are a pickle. So the card has no probe. `tt3d model check` reads
the archive and compares the number of classes with the labels.
"""

import argparse
import sys
import zipfile
from pathlib import Path
from typing import Any

from tt3d_tools.export import add_card_options, parse_labels
from tt3d_tools.package import (
    card_text,
    check_unit_range,
    file_sha256,
    score_keys,
    write_text_atomic,
)
from tt3d_tools.weights import WeightsError


def make_card(archive: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Return the card of `archive` with the values of the command line."""
    height, width = (options.size * 2)[:2]
    return {
        "name": options.name or archive.stem,
        "architecture": options.architecture,
        "source": options.source or archive.name,
        "licence": options.licence,
        "input_size": [height, width],
        "resize": options.resize or max(height, width),
        "interpolation": options.interpolation,
        "mean": options.mean,
        "std": options.std,
        "labels": parse_labels(options.labels),
        **score_keys(options.label_set, options.scores),
        "top1": None,
        "top5": None,
        "n": None,
        "sha256": file_sha256(archive),
    }


def main() -> int:
    """Run the command line; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tt3d_tools.card", description=__doc__)
    parser.add_argument("archive", type=Path, help="the .pt2 file; the card is written beside it")
    parser.add_argument("--architecture", default="unknown")
    parser.add_argument("--force", action="store_true", help="replace an existing card")
    add_card_options(parser, required=True)
    options = parser.parse_args()
    archive: Path = options.archive
    if not archive.is_file() or not zipfile.is_zipfile(archive):
        print(f"error: {archive}: not a .pt2 archive (a zip file)", file=sys.stderr)
        return 2
    card = archive.with_suffix(".json")
    if card.exists() and not options.force:
        print(f"error: {card}: exists already; --force replaces it", file=sys.stderr)
        return 2
    try:
        check_unit_range(options.mean, options.std)
        content = make_card(archive, options)
    except (WeightsError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    write_text_atomic(card, card_text(content))
    print(f"wrote {card}; check it with: tt3d model check {archive}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
