"""Test what the scripts for set-up and checks promise."""

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NAME = r"[a-z0-9][a-z0-9+.-]+"


def run(*words: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*map(str, words)], capture_output=True, text=True, cwd=ROOT, timeout=60, check=False
    )


@pytest.mark.parametrize("path", sorted((ROOT / "requirements").glob("apt*.txt")), ids=str)
def test_package_lists_are_names_and_alternatives(path: Path) -> None:
    lines = [line.split("#")[0].strip() for line in path.read_text().splitlines()]
    for line in filter(None, lines):
        assert re.fullmatch(rf"{NAME}( \| {NAME})*( \(optional\))?", line), line


def test_slowest_tests_come_first(tmp_path: Path) -> None:
    ctest, pytest_file = tmp_path / "ctest.xml", tmp_path / "pytest.xml"
    ctest.write_text(
        '<testsuite><testcase name="Box.IsClosed" classname="Box.IsClosed" time="2.5"/>'
        '<testcase name="Box.IsFast" classname="Box.IsFast" time="0.1"/></testsuite>'
    )
    pytest_file.write_text(
        '<testsuites><testsuite><testcase classname="tests.python.test_run" name="test_resume" '
        'time="30.25"/></testsuite></testsuites>'
    )
    done = run("scripts/slowest-tests", "--count", 2, ctest, pytest_file)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "The 2 slowest of 3 tests, in seconds:",
        "    30.2  pytest test_run::test_resume",
        "     2.5  ctest  Box.IsClosed",
    ]


@pytest.mark.parametrize("words", [[], ["sid"], ["bookworm", "--unknown"]], ids=str)
def test_fresh_machine_explains_its_usage(words: list[str]) -> None:
    done = run("scripts/fresh-machine", *words)
    assert done.returncode == 2
    assert "scripts/fresh-machine bookworm|trixie" in done.stderr


def test_readme_container_and_fresh_machine_run_the_same_commands() -> None:
    readme = re.findall(r"^    (scripts/\w+) +#", (ROOT / "README.md").read_text(), re.MULTILINE)
    container = re.findall(r"^RUN (.*)$", (ROOT / "Containerfile").read_text(), re.MULTILINE)
    fresh = re.search(r"commands=\((scripts/.*)\)", (ROOT / "scripts/fresh-machine").read_text())
    assert fresh is not None
    assert readme == container == fresh.group(1).split()
