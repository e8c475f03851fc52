"""What the tools that tt3d runs as child processes share: errors, progress, job files.

A tool prints `@progress DONE TOTAL` lines, ends with status 0, or says what is wrong in its last
line and ends with 2 (input), 3 (missing tool) or 5 (resources), the statuses of tt3d itself.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn


class ToolError(Exception):
    """Ends the tool with one line of text and an exit status."""

    status = 5


class InputProblem(ToolError):
    """Something is wrong with what the user gave."""

    status = 2


class MissingTool(ToolError):
    """A program, package or file that the work needs is absent; says how to get it."""

    status = 3


def need_package(name: str, purpose: str, package: str | None = None) -> Any:
    """Imports a Python package; MissingTool with the install command where it is absent."""
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MissingTool(
            f"{purpose} needs the Python package {package or name} ({error}); install it with "
            f"'{sys.executable} -m pip install {package or name}' or scripts/setup --all"
        ) from error


def need_program(name: str, purpose: str, package: str | None = None) -> str:
    """Finds a program; MissingTool with the install command where it is absent."""
    found = shutil.which(name)
    if found is None:
        raise MissingTool(
            f"{purpose} needs {name}; install it with 'apt-get install {package or name}' or "
            "scripts/setup --all"
        )
    return found


def progress(done: int, total: int) -> None:
    """Tells tt3d how far the work is."""
    print(f"@progress {done} {total}", flush=True)


def note(text: str) -> None:
    """Hands tt3d a line for its user."""
    print(f"@note {text}", flush=True)


def read_job(path: str) -> dict[str, Any]:
    """The JSON file that tt3d hands over."""
    return json.loads(Path(path).read_text())


def run_checked(command: list[str], what: str, time_limit: float | None = None) -> str:
    """Runs a program to its end; its last line of output is the error where it fails."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=time_limit)
    except subprocess.TimeoutExpired as error:
        raise ToolError(f"{what} took longer than {time_limit:.0f} s") from error
    if done.returncode != 0:
        lines = (done.stderr.strip() or done.stdout.strip() or "no message").splitlines()
        raise InputProblem(f"{what} failed: {lines[-1]}")
    return done.stdout


def main(work: Callable[[list[str]], None]) -> NoReturn:
    """Runs a tool on the command line's arguments and ends the process as tt3d expects."""
    try:
        work(sys.argv[1:])
    except ToolError as error:
        print(f"{error}", flush=True)
        sys.exit(error.status)
    except MemoryError:
        print("out of memory", flush=True)
        sys.exit(5)
    sys.exit(0)
