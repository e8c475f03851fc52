"""The capture's folder: which step made which file, and which files are the user's own.

capture.json records for each step a hash of its inputs and the hashes of its products. A step is
skipped if its inputs are unchanged and its products exist. A product whose hash is not the recorded
one is the user's: it is never overwritten, and later steps use it.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tt3d_tools import toolkit

RECORD = "capture.json"
WORK = ".work"  # folder of intermediate files


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file."""
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def hash_value(value: Any) -> str:
    """Return the SHA-256 of a JSON value."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def write_atomic(path: Path, text: str) -> None:
    """Write a file that is complete or absent."""
    part = path.with_name(path.name + ".part")
    with open(part, "w") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)


def replace_folder(made: Path, folder: Path) -> None:
    """Move a complete folder to its place."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.parent.mkdir(parents=True, exist_ok=True)
    made.rename(folder)


class Folder:
    """A capture that is being made."""

    def __init__(self, path: Path, restart: bool) -> None:
        """Open or create the folder; `restart` removes what earlier steps made, not more."""
        self.path = path
        self.work = path / WORK
        self.record: dict[str, Any] = {"steps": {}}
        if (path / RECORD).exists():
            try:
                self.record = json.loads((path / RECORD).read_text())
                self.record["steps"].items()
            except (ValueError, KeyError, TypeError) as error:
                raise toolkit.InputProblem(
                    f"{path / RECORD}: is damaged ({error}); remove it"
                ) from error
        elif path.exists() and any(path.iterdir()) and not self.may_use():
            raise toolkit.InputProblem(
                f"{path}: holds other files; give --out a new folder, or one with images/"
            )
        if restart:
            for step in self.record["steps"].values():
                for name in step["products"]:
                    file = path / name
                    if file.exists() and not self.is_own(hash_file(file)):
                        file.unlink()
            self.record = {"steps": {}}
            shutil.rmtree(self.work, ignore_errors=True)
        self.work.mkdir(parents=True, exist_ok=True)

    def may_use(self) -> bool:
        """Tell whether a folder without a record looks like a capture that an interrupted run left
        or a user prepared."""
        known = {"images", "sparse", "masks", "gains.json", "images.part", WORK}
        names = [entry.name for entry in self.path.iterdir()]
        return all(name in known or name.startswith(".") for name in names)

    def claim(self, made: Path) -> None:
        """Record files that a step has made, before it moves them to their place."""
        known = set(self.record.get("made", []))
        known |= {hash_file(path) for path in made.rglob("*") if path.is_file()}
        self.record["made"] = sorted(known)
        self.save()

    def is_own(self, digest: str) -> bool:
        """Tell whether a file with this hash is the user's: no step has made it."""
        return digest not in self.record.get("made", [])

    def save(self) -> None:
        """Write the record."""
        write_atomic(self.path / RECORD, json.dumps(self.record, indent=1) + "\n")

    def files(self, pattern: str) -> dict[str, str]:
        """Return the hashes of the files that match a pattern, by relative name."""
        return {
            str(path.relative_to(self.path)): hash_file(path)
            for path in sorted(self.path.glob(pattern))
            if path.is_file()
        }

    def step(
        self,
        name: str,
        inputs: Any,
        pattern: str,
        work: Callable[[], dict[str, Any]],
        keep: bool = True,
    ) -> dict[str, Any]:
        """Run a step if needed; return its hashes and facts.

        With `keep`, a product that the user replaced is kept and the step does not run.
        """
        old = self.record["steps"].get(name)
        key = hash_value(inputs)
        products = self.files(pattern)
        yours = any(self.is_own(digest) for digest in products.values())
        same = old is not None and old["inputs"] == key
        if products and keep and yours:
            toolkit.note(f"{name}: {pattern.removesuffix('/*')} is your own and is kept")
            facts = old["facts"] if old is not None else {}
            entry = {
                "inputs": key,
                "products": products,
                "seconds": 0,
                "yours": True,
                "facts": facts,
            }
        elif products and same and set(old["products"]) <= set(products):
            entry = {**old, "products": products}
        else:
            start = time.monotonic()
            facts = work()
            seconds = round(time.monotonic() - start, 1)
            entry = {
                "inputs": key,
                "products": self.files(pattern),
                "seconds": seconds,
                "yours": False,
                "facts": facts,
            }
            toolkit.note(f"{name}: {seconds:.0f} s")
        self.record["steps"][name] = entry
        self.save()
        return entry
