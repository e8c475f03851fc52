"""Helpers of the tables: run the program, and start a run folder from another run's object."""

import hashlib
import json
import os
import subprocess
from pathlib import Path

from method_plan import CAPTURES


def tt3d(program: Path, *arguments: str | Path, threads: int = 0) -> None:
    """Run the program without output, with the shared models on its path; raise if it fails."""
    models = f"{CAPTURES.parent / 'models'}:{os.environ.get('TT3D_MODELS', '')}"
    share = ("--threads", str(threads)) if threads else ()
    subprocess.run([program, *map(str, arguments), "-q", *share], check=True,
                   stdout=subprocess.DEVNULL,
                   env={**os.environ, "TT3D_MODELS": models})  # fmt: skip


def share_object(obj: Path, folder: Path) -> None:
    """Make a run folder that uses the field and mesh of another run."""
    if (folder / "run.json").is_file():
        return
    folder.mkdir(parents=True, exist_ok=True)
    for part in ("field", "mesh"):
        (folder / part).unlink(missing_ok=True)
        (folder / part).symlink_to((obj / part).resolve())
    record = json.loads((obj / "run.json").read_text(encoding="utf-8"))
    record["stages"] = [s for s in record["stages"] if s["name"] in ("field", "mesh")]
    (folder / "run.json").write_text(json.dumps(record), encoding="utf-8")


def sha256(path: Path) -> str:
    """Return a file's SHA-256 as hex, the form that records use."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
