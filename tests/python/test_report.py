"""The report page opened from disk in headless Chromium: it draws, and the console stays clean."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
BUILD = Path(os.environ.get("TT3D_BUILD", ROOT / "build/release"))
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
BACKGROUND = (247, 247, 245)

pytestmark = pytest.mark.skipif(BROWSER is None, reason="chromium is not installed")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    program = BUILD / "tests/report/report_test"
    if not program.exists():
        pytest.skip(f"{program} is not built")
    folder = tmp_path_factory.mktemp("report")
    subprocess.run(
        [program, "--gtest_filter=Report.WrittenForTheBrowser"],
        env={**os.environ, "TT3D_REPORT_OUT": str(folder)},
        check=True,
        capture_output=True,
    )
    return folder / "report.html"


def browse(
    address: str, folder: Path, *options: str, webgl: bool = True
) -> subprocess.CompletedProcess:
    graphics = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
    return subprocess.run(
        [
            BROWSER,
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            *(graphics if webgl else ("--disable-3d-apis",)),
            "--enable-logging=stderr",
            "--virtual-time-budget=4000",
            f"--user-data-dir={folder / 'profile'}",
            *options,
            address,
        ],
        check=True,
        capture_output=True,
        text=True,
        timeout=300,
    )


def console_lines(log: str) -> list[str]:
    """What the page wrote to the console; remarks of the graphics driver are not the page's."""
    lines = [line for line in log.splitlines() if ":CONSOLE" in line]
    return [line for line in lines if not re.search(r"GL Driver Message|software WebGL", line)]


def test_objects_are_drawn_and_the_console_is_clean(page: Path, tmp_path: Path) -> None:
    result = browse(f"{page.as_uri()}#measure", tmp_path, "--dump-dom")
    assert 'data-viewer="drawn"' in result.stdout
    coverage = re.search(r'data-coverage="([\d.]+) ([\d.]+)"', result.stdout)
    assert coverage
    # A sphere in the middle of each picture.
    assert all(0.1 < float(share) < 0.6 for share in coverage.groups())
    assert console_lines(result.stderr) == []


def test_without_webgl_there_is_a_sentence(page: Path, tmp_path: Path) -> None:
    result = browse(page.as_uri(), tmp_path, "--dump-dom", webgl=False)
    assert 'data-viewer="unavailable"' in result.stdout
    assert re.search(r'<p id="no-webgl" class="warning">', result.stdout)


@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_sticks_out_at_the_side(page: Path, tmp_path: Path, width: int) -> None:
    """The page in a frame of the given width: what is right of its margin stays background."""
    frame = tmp_path / "frame.html"
    frame.write_text(
        f'<!DOCTYPE html><body style="margin:0"><iframe src="{page.as_uri()}" '
        f'style="border:0;width:{width}px;height:6000px"></iframe></body>'
    )
    picture = tmp_path / "page.png"
    browse(
        frame.as_uri(),
        tmp_path,
        "--hide-scrollbars",
        f"--screenshot={picture}",
        f"--window-size={max(width, 500)},6000",
    )
    with Image.open(picture) as image:
        margin = image.convert("RGB").crop((width - 10, 0, width, 3000))
    colours = {colour for _, colour in margin.getcolors(30000)}
    assert colours == {BACKGROUND}
