"""The report page opened from disk in headless Chromium: it draws, and the console stays clean."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

webdriver = pytest.importorskip("selenium.webdriver")

from selenium.webdriver.support.ui import WebDriverWait  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
BUILD = Path(os.environ.get("TT3D_BUILD", ROOT / "build/release"))
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
DRIVER = shutil.which("chromedriver")
PATIENCE = 120  # seconds; starting software WebGL on a cold, busy machine takes some

pytestmark = pytest.mark.skipif(
    BROWSER is None or DRIVER is None, reason="chromium or chromium-driver is not installed"
)


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


@contextmanager
def browser(*, webgl: bool = True) -> Iterator[webdriver.Chrome]:
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    graphics = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
    for option in (
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-dev-shm-usage",
        *(graphics if webgl else ("--disable-3d-apis",)),
    ):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    try:
        yield driver
    finally:
        driver.quit()


def root_attribute(driver: webdriver.Chrome, name: str) -> str | None:
    return driver.execute_script(f"return document.documentElement.getAttribute('{name}')")


def viewer_state(driver: webdriver.Chrome) -> str:
    """What became of the 3D view, once the page knows."""
    return WebDriverWait(driver, PATIENCE).until(lambda d: root_attribute(d, "data-viewer"))


def console_lines(driver: webdriver.Chrome) -> list[str]:
    """What the page wrote to the console; remarks of the graphics driver are not the page's."""
    lines = [entry["message"] for entry in driver.get_log("browser")]
    return [line for line in lines if not re.search(r"GL Driver Message|software WebGL", line)]


def test_objects_are_drawn_and_the_console_is_clean(page: Path) -> None:
    with browser() as driver:
        driver.get(f"{page.as_uri()}#measure")
        assert viewer_state(driver) == "drawn"
        shares = [float(share) for share in root_attribute(driver, "data-coverage").split()]
        # A sphere in the middle of each picture.
        assert len(shares) == 2
        assert all(0.1 < share < 0.6 for share in shares)
        assert console_lines(driver) == []


def test_without_webgl_there_is_a_sentence(page: Path) -> None:
    with browser(webgl=False) as driver:
        driver.get(page.as_uri())
        assert viewer_state(driver) == "unavailable"
        assert driver.find_element("id", "no-webgl").is_displayed()


@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_sticks_out_at_the_side(page: Path, width: int) -> None:
    with browser() as driver:
        driver.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride",
            {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600},
        )
        driver.get(page.as_uri())
        assert viewer_state(driver) == "drawn"
        shown, needed = driver.execute_script(
            "const e = document.documentElement; return [e.clientWidth, e.scrollWidth]"
        )
        assert width - 20 <= shown == needed  # a scroll bar at the right is no part of the page
