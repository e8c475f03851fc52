"""Check that every command reports a bad asset, run or video in one line."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parent))
from tool_support import PROGRAM, ROOT, TOY, tt3d, write_asset

pytestmark = pytest.mark.skipif(not PROGRAM.exists(), reason="tt3d is not built")

TRIANGLES = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
FACES = "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def corrupt(folder: Path) -> Path:
    path = folder / "corrupt.glb"
    path.write_bytes(np.random.default_rng(1).bytes(5000))
    return path


def truncated(folder: Path) -> Path:
    whole = folder / "whole.glb"
    assert tt3d("export", write_asset(folder), "--out", whole).returncode == 0
    path = folder / "truncated.glb"
    path.write_bytes(whole.read_bytes()[:-3000])
    return path


def no_faces(folder: Path) -> Path:
    path = folder / "points.obj"
    path.write_text(TRIANGLES)
    return path


def empty(folder: Path) -> Path:
    path = folder / "empty.obj"
    path.write_text("")
    return path


def index_beyond(folder: Path) -> Path:
    path = folder / "beyond.obj"
    path.write_text(TRIANGLES + "f 1 2 9\n")
    return path


def not_finite(folder: Path) -> Path:
    path = folder / "nan.obj"
    path.write_text("v nan 0 0\n" + TRIANGLES + FACES)
    return path


def missing_texture(folder: Path) -> Path:
    path = write_asset(folder)
    (folder / "asset.png").unlink()
    return path


def missing_materials(folder: Path) -> Path:
    path = write_asset(folder)
    (folder / "asset.mtl").unlink()
    return path


def huge_file(folder: Path) -> Path:
    """Write a sparse file of 60 GB."""
    path = folder / "huge.obj"
    path.write_text(TRIANGLES + FACES)
    os.truncate(path, 60 << 30)
    return path


def huge_texture(folder: Path) -> Path:
    """Write a small PNG whose header says 60,000 by 60,000 pixels."""
    path = write_asset(folder)

    def chunk(kind: bytes, data: bytes) -> bytes:
        sum_ = struct.pack(">I", zlib.crc32(kind + data))
        return struct.pack(">I", len(data)) + kind + data + sum_

    header = struct.pack(">IIBBBBB", 60000, 60000, 8, 2, 0, 0, 0)
    content = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0" * 1000))
    (folder / "asset.png").write_bytes(b"\x89PNG\r\n\x1a\n" + content + chunk(b"IEND", b""))
    return path


def huge_count(folder: Path) -> Path:
    """Write a GLB of 500 bytes whose accessor says that it has four billion vertices."""
    count = 4_000_000_000
    document = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "scene": 0,
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary = struct.pack("<II", 36, 0x004E4942) + b"\0" * 36
    size = 12 + 8 + len(text) + len(binary)
    path = folder / "count.glb"
    path.write_bytes(
        struct.pack("<III", 0x46546C67, 2, size)
        + struct.pack("<II", len(text), 0x4E4F534A)
        + text
        + binary
    )
    return path


#: For each fault, the function that writes the file, and the name that the error must have.
BAD: dict[str, tuple[Callable[[Path], Path], str]] = {
    "corrupt": (corrupt, "corrupt.glb"),
    "truncated": (truncated, "truncated.glb"),
    "no faces": (no_faces, "points.obj"),
    "empty": (empty, "empty.obj"),
    "index beyond": (index_beyond, "beyond.obj:5"),
    "not finite": (not_finite, "nan.obj:1"),
    "missing texture": (missing_texture, "asset.png"),
    "missing materials": (missing_materials, "asset.mtl"),
    "huge file": (huge_file, "huge.obj"),
    "huge texture": (huge_texture, "asset.png"),
    "huge count": (huge_count, "count.glb"),
    "absent": (lambda folder: folder / "absent.glb", "absent.glb"),
    "another format": (lambda folder: Path(TOY), "toy_cnn.pt2"),
}


def commands(asset: Path, folder: Path) -> dict[str, list[object]]:
    """Return a call of every command that reads an asset."""
    out = folder / "out"
    return {
        "evaluate": ["evaluate", asset, "--target", 0, "--victims", TOY, "--views", 1,
                     "--out", out / "e.json"],
        "render": ["render", asset, "--views", 1, "--size", 32, "--out", out / "views"],
        "judge": ["judge", "zeroshot", asset, "--text", "a. b.", "--model", folder],
        "print-check": ["print-check", asset],
        "export": ["export", asset, "--out", out / "x.stl"],
    }  # fmt: skip


def limited(words: list[object]) -> subprocess.CompletedProcess[str]:
    """Run the program with 12 GiB of address space."""
    shell = 'ulimit -v 12582912; exec "$0" "$@"'
    return subprocess.run(
        ["bash", "-c", shell, str(PROGRAM), *map(str, words)],
        capture_output=True, text=True, timeout=300, cwd=ROOT,
    )  # fmt: skip


def one_line(done: subprocess.CompletedProcess[str], status: int, *parts: str) -> None:
    lines = done.stderr.strip().splitlines()
    assert done.returncode == status, done.stderr
    assert len(lines) == 1 and lines[0].startswith("tt3d: "), done.stderr
    for part in parts:
        assert part in lines[0]


@pytest.mark.parametrize("what", BAD)
def test_each_command_names_the_bad_file(tmp_path: Path, what: str) -> None:
    build, name = BAD[what]
    asset = build(tmp_path)
    for command in commands(asset, tmp_path).values():
        one_line(limited(command), 2, name)
    assert not (tmp_path / "out/x.stl").exists()


def test_no_texture_no_uvs_and_several_materials_are_rendered(tmp_path: Path) -> None:
    plain = tmp_path / "plain.obj"
    plain.write_text(TRIANGLES + FACES)
    (tmp_path / "two.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n")
    two = tmp_path / "two.obj"
    first, *rest = FACES.splitlines()
    two.write_text(
        f"mtllib two.mtl\n{TRIANGLES}usemtl red\n{first}\nusemtl blue\n" + "\n".join(rest) + "\n"
    )
    for asset, colours in ((plain, {(255, 255, 255)}), (two, {(255, 0, 0), (0, 0, 255)})):
        out = tmp_path / asset.stem
        done = tt3d("render", asset, "--views", 12, "--view-distribution", "sphere", "--size", 64,
                    "--out", out)  # fmt: skip
        assert done.returncode == 0, done.stderr
        seen = set()
        for file in sorted((out / "test").glob("*.png")):
            picture = np.asarray(Image.open(file).convert("RGBA"))
            seen |= set(map(tuple, picture[picture[..., 3] == 255][:, :3]))
        assert colours <= seen
        for words in (["export", asset, "--out", out / "x.glb"], ["print-check", asset]):
            done = tt3d(*words)
            assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("option", ["--half-mlp", "--cuda-graphs"])
def test_gpu_options_are_errors_on_a_cpu(tmp_path: Path, option: str) -> None:
    out = tmp_path / "run"
    one_line(limited(["fit", tmp_path, "--device", "cpu", option, "--out", out]), 2, option)
    assert not out.exists()


def test_a_folder_that_is_not_a_run(tmp_path: Path) -> None:
    one_line(limited(["report", tmp_path]), 2, "not a run folder")
    one_line(limited(["bake", tmp_path / "absent"]), 2, "absent")
    (tmp_path / "run.json").write_text("{")
    one_line(limited(["report", tmp_path]), 2, "run.json")
    one_line(limited(["bake", tmp_path]), 2, "run.json")
    (tmp_path / "run.json").write_text("[]")
    one_line(limited(["report", tmp_path]), 2, "run.json")
    one_line(limited(["report", tmp_path, tmp_path, "--out", tmp_path / "o"]), 2, "eval/")
    (tmp_path / "eval").mkdir()
    (tmp_path / "run.json").write_text("{")
    (tmp_path / "eval/a.json").write_text('{"victims": [], "renderer": {}}')
    one_line(limited(["report", tmp_path, tmp_path, "--out", tmp_path / "o"]), 2, "run.json")
