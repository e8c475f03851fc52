"""Open the report from disk in headless Chromium; check the drawing and the empty console."""

from __future__ import annotations

import itertools
import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

webdriver = pytest.importorskip("selenium.webdriver")

from selenium.webdriver.common.action_chains import ActionChains  # noqa: E402
from selenium.webdriver.common.keys import Keys  # noqa: E402
from selenium.webdriver.support.ui import WebDriverWait  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
BUILD = Path(os.environ.get("TT3D_BUILD", ROOT / "build/release"))
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
DRIVER = shutil.which("chromedriver")
PATIENCE = 120  # seconds; software WebGL starts slowly on a busy machine

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
        [program, "--gtest_filter=*.WrittenForTheBrowser"],
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
    """Wait for the state of the 3D view and return it."""
    return WebDriverWait(driver, PATIENCE).until(lambda d: root_attribute(d, "data-viewer"))


def console_lines(driver: webdriver.Chrome) -> list[str]:
    """Return the page's console messages without those of the graphics driver."""
    lines = [entry["message"] for entry in driver.get_log("browser")]
    return [line for line in lines if not re.search(r"GL Driver Message|software WebGL", line)]


def test_objects_are_drawn_and_the_console_is_clean(page: Path) -> None:
    with browser() as driver:
        driver.get(f"{page.as_uri()}#measure")
        assert viewer_state(driver) == "drawn"
        shares = [float(share) for share in root_attribute(driver, "data-coverage").split()]
        # There is a sphere in the middle of each picture.
        assert len(shares) == 2
        assert all(0.1 < share < 0.6 for share in shares)
        assert console_lines(driver) == []


def test_without_webgl_the_page_shows_a_warning(page: Path) -> None:
    with browser(webgl=False) as driver:
        driver.get(page.as_uri())
        assert viewer_state(driver) == "unavailable"
        assert driver.find_element("id", "no-webgl").is_displayed()


def set_width(driver: webdriver.Chrome, width: int) -> None:
    driver.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600},
    )


@pytest.mark.parametrize("width", [390, 1280])
def test_the_page_has_no_horizontal_overflow(page: Path, width: int) -> None:
    with browser() as driver:
        set_width(driver, width)
        driver.get(page.as_uri())
        assert viewer_state(driver) == "drawn"
        shown, needed = driver.execute_script(
            "const e = document.documentElement; return [e.clientWidth, e.scrollWidth]"
        )
        assert width - 20 <= shown == needed  # a scroll bar at the right is not part of the page
        assert console_lines(driver) == []


DESCRIBE_FOCUS = """
const e = document.activeElement;
if (e === document.body) return null;
const style = getComputedStyle(e);
return [e.tagName, e.id || e.className, (e.getAttribute("aria-label") || e.textContent).trim(),
        style.outlineStyle !== "none" || e.className === "skip"];
"""


@pytest.mark.parametrize("width", [390, 1280])
def test_the_comparison_fits_any_screen(page: Path, width: int) -> None:
    with browser() as driver:
        set_width(driver, width)
        driver.get((page.parent / "comparison.html").as_uri())
        shown, needed = driver.execute_script(
            "const e = document.documentElement; return [e.clientWidth, e.scrollWidth]"
        )
        assert width - 20 <= shown == needed
        titles = [e.text for e in driver.find_elements("tag name", "h2")]
        assert titles == ["Attack success", "Other tasks", "Videos"]
        assert console_lines(driver) == []


@pytest.mark.parametrize("width", [390, 1280])
def test_the_keyboard_reaches_all_controls(page: Path, width: int) -> None:
    with browser() as driver:
        set_width(driver, width)
        driver.get(page.as_uri())
        assert viewer_state(driver) == "drawn"
        reached = []
        for _ in range(100):
            ActionChains(driver).send_keys(Keys.TAB).perform()
            focus = driver.execute_script(DESCRIBE_FOCUS)
            if focus is None or focus in reached:
                break
            reached.append(focus)
        assert reached[0][2] == "Skip to the results"
        assert all(name and visible for _, _, name, visible in reached)
        tags = [tag for tag, *_ in reached]
        assert tags.count("CANVAS") == 2 and tags.count("BUTTON") == 2
        names = {name for _, _, name, _ in reached}
        regions = driver.find_elements("css selector", ".scroll")
        assert len(regions) >= 4
        assert {r.get_attribute("aria-label") for r in regions} <= names
        assert {s.text for s in driver.find_elements("tag name", "summary")} <= names


def test_arrow_keys_turn_the_object(page: Path) -> None:
    with browser() as driver:
        driver.get(page.as_uri())
        assert viewer_state(driver) == "drawn"
        button = driver.find_element("id", "pause")
        if button.get_attribute("aria-pressed") == "false":
            button.send_keys(Keys.SPACE)
        assert button.get_attribute("aria-pressed") == "true" and button.text == "Turn"
        canvas = driver.find_elements("tag name", "canvas")[1]
        driver.execute_script("arguments[0].focus()", canvas)
        before = canvas.screenshot_as_png
        assert canvas.screenshot_as_png == before
        canvas.send_keys(*[Keys.ARROW_RIGHT] * 6)
        WebDriverWait(driver, PATIENCE).until(lambda _: canvas.screenshot_as_png != before)


def test_the_accessibility_tree(page: Path) -> None:
    """Check the accessibility tree: landmarks, headings in order, names of all pictures."""
    with browser() as driver:
        driver.get(page.as_uri())
        assert viewer_state(driver) == "drawn"
        driver.execute_cdp_cmd("Accessibility.enable", {})
        tree = driver.execute_cdp_cmd("Accessibility.getFullAXTree", {})["nodes"]
    nodes = [n for n in tree if not n.get("ignored")]

    def names(role: str) -> list[str]:
        same = [n for n in nodes if n.get("role", {}).get("value") == role]
        return [n.get("name", {}).get("value", "").strip() for n in same]

    assert len(names("main")) == 1
    levels = [
        next(p["value"]["value"] for p in n["properties"] if p["name"] == "level")
        for n in nodes
        if n.get("role", {}).get("value") == "heading"
    ]
    assert levels[0] == 1 and levels.count(1) == 1
    assert all(b <= a + 1 for a, b in itertools.pairwise(levels))
    regions = names("region")
    for part in (
        "Attack success",
        "Other renderers",
        "Other tasks",
        "Videos",
        "By task",
        "Frames of table <&>.mp4",
    ):
        assert part in regions
    for role in ("image", "img", "button", "link", "region", "columnheader", "rowheader"):
        assert all(names(role)), role
    assert sum("object in 3D" in name for name in names("image") + names("img")) == 2
