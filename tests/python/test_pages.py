"""Run the commands of the pages on models, and check that the tests they name exist."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
BUILD = Path(os.environ.get("TT3D_BUILD", ROOT / "build/release"))
BLOCK = re.compile(r"^```(\w+) ?(\S*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def page(name: str) -> str:
    return (ROOT / "docs" / name).read_text(encoding="utf-8")


def environment() -> dict[str, str]:
    paths = (str(Path(sys.executable).parent), str(BUILD), os.environ["PATH"])
    return {**os.environ, "PYTHONPATH": str(ROOT / "python"), "PATH": ":".join(paths)}


def test_bring_your_own_model_as_the_page_says(tmp_path: Path) -> None:
    if not (BUILD / "tt3d").is_file():
        pytest.skip("tt3d is not built")
    Image.new("RGB", (90, 80), (200, 40, 60)).save(tmp_path / "photo.png")
    output = ""
    for kind, name, text in BLOCK.findall(page("bring-your-own-model.md")):
        if kind != "sh":
            (tmp_path / name).write_text(text)
            continue
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", text],
            cwd=tmp_path,
            env=environment(),
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, f"{text}\n{done.stdout}{done.stderr}"
        output += done.stdout + done.stderr
    for part in ("wrote models/birds.pt2", "probe: logits within", "photo.png:", "no probe"):
        assert part in output


def test_errors_of_the_page_are_those_of_the_program() -> None:
    sources = "".join(path.read_text() for path in (ROOT / "src/model").glob("*.cpp"))
    joined = re.sub(r'"\s*"', "", sources)
    table = page("bring-your-own-model.md").split("## When it is refused")[1]
    errors = re.findall(r"^\| `([^`]+)`", table, re.MULTILINE)
    assert len(errors) >= 7
    for error in errors:
        assert error in joined, error


def test_every_promise_names_tests_that_exist() -> None:
    program = BUILD / "tests/model/model_test"
    if not program.is_file():
        pytest.skip("model_test is not built")
    listing = subprocess.check_output([program, "--gtest_list_tests"], text=True)
    suite, known = "", set()
    for line in listing.splitlines():
        if line.startswith("  "):
            known.add(suite + line.split()[0])
        else:
            suite = line.strip()
    named = re.findall(r"`([A-Z]\w+\.[A-Z]\w+)`", page("threat-model.md"))
    assert len(named) >= 20
    assert set(named) <= known, set(named) - known


def run_model(*arguments: str) -> subprocess.CompletedProcess[str]:
    if not (BUILD / "tt3d").is_file():
        pytest.skip("tt3d is not built")
    return subprocess.run([BUILD / "tt3d", "model", *arguments], capture_output=True, text=True)


TOY = str(ROOT / "tests/model/fixtures/toy_cnn.pt2")


def test_options_of_the_model_commands() -> None:
    assert run_model("check", TOY, "--device", "cpu", "--threads", "1").returncode == 0
    assert run_model("check", TOY, "--device", "gpu").returncode == 2
    assert run_model("check", TOY, "--precision", "float16").returncode == 2
    read = run_model("check", TOY, "--no-probe", "--json")
    assert read.returncode == 0
    assert '"probe": null' in read.stdout


def test_reduced_precision_is_an_error_if_it_is_not_faster() -> None:
    import torch

    if torch.cuda.is_available():
        pytest.skip("a CUDA device has both")
    done = run_model("check", TOY, "--precision", "tf32")
    assert done.returncode == 2 and "CUDA" in done.stderr
    has = torch.cpu.get_capabilities()
    done = run_model("check", TOY, "--precision", "bf16")
    if has["avx512_bf16"] or has["amx_bf16"]:
        assert done.returncode == 0, done.stderr
    else:
        assert done.returncode == 2 and "slower" in done.stderr
