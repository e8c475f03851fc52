"""Write TensorBoard event files of an attack's curves.

    python -m tt3d_tools.event_files RUN [--out FOLDER]

It reads RUN/attack/curves.csv and epochs.csv and writes RUN/attack/tensorboard. It needs the
package of requirements/tensorboard.txt.
"""

import argparse
import csv
import sys
from pathlib import Path

MISSING_TOOL = 3


def write_events(attack: Path, out: Path) -> int:
    """Write every column of the attack's tables as a scalar; return the number of values."""
    from torch.utils.tensorboard import SummaryWriter

    count = 0
    with SummaryWriter(str(out)) as writer:
        for table in ("curves", "epochs"):
            path = attack / f"{table}.csv"
            if not path.is_file():
                continue
            for row in csv.DictReader(path.read_text(encoding="utf-8").splitlines()):
                step = int(row.pop("step"))
                for name, value in row.items():
                    writer.add_scalar(f"{table}/{name}", float(value), step)
                    count += 1
    return count


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path, metavar="RUN", help="run folder with a finished attack")
    parser.add_argument("--out", type=Path, help="default: RUN/attack/tensorboard")
    options = parser.parse_args()
    attack = options.run / "attack"
    if not (attack / "curves.csv").is_file():
        parser.error(f"{attack / 'curves.csv'}: expected the curves of a finished attack")
    out = options.out or attack / "tensorboard"
    try:
        count = write_events(attack, out)
    except ImportError as error:
        print(f"tensorboard: {error}; pip install -r requirements/tensorboard.txt", file=sys.stderr)
        sys.exit(MISSING_TOOL)
    print(f"{count} numbers: {out}")


if __name__ == "__main__":
    main()
