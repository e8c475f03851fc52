"""Errors, progress and job files of the tools that tt3d runs as child processes.

A tool prints `@progress DONE TOTAL` lines and ends with status 0. If it fails, its last line says
why, and it ends with a status of tt3d itself: 2 (input), 3 (missing tool) or 5 (resources).
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
    """An error that ends the tool with one line of text and an exit status."""

    status = 5


class InputProblem(ToolError):
    """The input is wrong."""

    status = 2


class MissingTool(ToolError):
    """A needed program, package or file is absent; the text says how to get it."""

    status = 3


def need_package(name: str, purpose: str, package: str | None = None) -> Any:
    """Import a Python package; raise MissingTool with the install command if it is absent."""
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MissingTool(
            f"{purpose} needs the Python package {package or name} ({error}); install it with "
            f"'{sys.executable} -m pip install {package or name}' or scripts/setup --all"
        ) from error


def need_program(name: str, purpose: str, package: str | None = None) -> str:
    """Find a program; raise MissingTool with the install command if it is absent."""
    found = shutil.which(name)
    if found is None:
        raise MissingTool(
            f"{purpose} needs {name}; install it with 'apt-get install {package or name}' or "
            "scripts/setup --all"
        )
    return found


def progress(done: int, total: int) -> None:
    """Report the progress to tt3d."""
    print(f"@progress {done} {total}", flush=True)


def stage(name: str) -> None:
    """Begin a stage of the work; the progress that follows is shown under its name."""
    print(f"@stage {name}", flush=True)


def note(text: str) -> None:
    """Send a line to tt3d for the user."""
    print(f"@note {text}", flush=True)


def read_job(path: str) -> dict[str, Any]:
    """Read the JSON file that tt3d passes."""
    return json.loads(Path(path).read_text())


def run_checked(command: list[str], what: str, time_limit: float | None = None) -> str:
    """Run a program to its end; if it fails, its last line of output is the error text."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=time_limit)
    except subprocess.TimeoutExpired as error:
        raise ToolError(f"{what} took longer than {time_limit:.0f} s") from error
    if done.returncode != 0:
        lines = (done.stderr.strip() or done.stdout.strip() or "no message").splitlines()
        raise InputProblem(f"{what} failed: {lines[-1]}")
    return done.stdout


def main(work: Callable[[list[str]], None]) -> NoReturn:
    """Run a tool on the command line's arguments and exit with the status that tt3d expects."""
    try:
        work(sys.argv[1:])
    except ToolError as error:
        print(f"{error}", flush=True)
        sys.exit(error.status)
    except MemoryError:
        print("out of memory", flush=True)
        sys.exit(5)
    sys.exit(0)
