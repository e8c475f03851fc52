"""PSNR, SSIM and LPIPS against other implementations; distances between known surfaces."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

np = pytest.importorskip("numpy")
trimesh = pytest.importorskip("trimesh")

TOOLS = Path(__file__).resolve().parents[2] / "python/tt3d_tools"
sys.path.insert(0, str(TOOLS))


@pytest.mark.parametrize("net", ["vgg", "alex", "squeeze"])
def test_lpips_agrees_with_the_package(tmp_path: Path, net: str) -> None:
    """A random backbone, given as a file of torchvision's keys."""
    lpips = pytest.importorskip("lpips")
    torch = pytest.importorskip("torch")
    torchvision = pytest.importorskip("torchvision")
    from PIL import Image

    torch.manual_seed(1)
    build = {"vgg": "vgg16", "alex": "alexnet", "squeeze": "squeezenet1_1"}[net]
    backbone = getattr(torchvision.models, build)(weights=None)
    torch.save(backbone.state_dict(), tmp_path / "net.pth")
    expected = lpips.LPIPS(net=net, pnet_rand=True, verbose=False).eval()
    layers = dict(backbone.features.named_parameters())
    with torch.no_grad():
        for name, value in expected.net.named_parameters():
            value.copy_(layers[name.split(".", 1)[1]])
    random = np.random.default_rng(2)
    pictures = [random.integers(0, 256, (96, 80, 3), dtype=np.uint8) for _ in range(2)]
    for i, picture in enumerate(pictures):
        Image.fromarray(picture).save(tmp_path / f"{i}.png")
    pairs = [[str(tmp_path / "0.png"), str(tmp_path / "1.png"), [8, 4, 78, 90]]]
    (tmp_path / "pairs.json").write_text(json.dumps(pairs))
    command = [sys.executable, str(TOOLS / "perceptual.py"), net, str(tmp_path / "net.pth")]
    command += [str(tmp_path / "pairs.json"), str(tmp_path / "out.json")]
    subprocess.run(command, check=True, capture_output=True)
    result = json.loads((tmp_path / "out.json").read_text())
    a, b = (torch.tensor(p).permute(2, 0, 1)[None] / 127.5 - 1 for p in pictures)
    with torch.no_grad():
        assert result["lpips"] == pytest.approx(float(expected(a, b)), abs=1e-4)
        box = expected(a[:, :, 4:90, 8:78], b[:, :, 4:90, 8:78])
    assert result["lpips_box"] == pytest.approx(float(box), abs=1e-4)


def test_lpips_without_a_backbone_says_what_to_download(tmp_path: Path) -> None:
    pytest.importorskip("lpips")
    pytest.importorskip("torchvision")
    command = [
        sys.executable,
        str(TOOLS / "perceptual.py"),
        "vgg",
        str(tmp_path / "vgg.pth"),
        "",
        "",
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 3
    assert "vgg16-397923af.pth" in done.stdout and str(tmp_path / "vgg.pth") in done.stdout


def test_concentric_spheres_are_their_difference_of_radii_apart() -> None:
    pytest.importorskip("embreex")
    from geometry import distances

    a = trimesh.creation.icosphere(4, 1.0)
    b = trimesh.creation.icosphere(4, 1.1)
    found = distances(a, b)
    assert found["chamfer"] == pytest.approx(0.1, abs=2e-3)
    assert found["hausdorff"] == pytest.approx(0.1, abs=2e-3)
    assert found["normal_deviation_deg"] < 3
    same = distances(a, a)
    assert same["chamfer"] < 1e-6 and same["hausdorff"] < 1e-6


def test_hausdorff_sees_a_spike_that_chamfer_hardly_does() -> None:
    pytest.importorskip("embreex")
    from geometry import distances

    a = trimesh.creation.icosphere(4, 1.0)
    b = a.copy()
    b.vertices[0] *= 1.5
    found = distances(a, b)
    assert found["hausdorff"] == pytest.approx(0.5, abs=0.02)
    assert found["chamfer"] < 0.01


def test_self_intersections_of_two_spheres_that_overlap() -> None:
    pytest.importorskip("embreex")
    from geometry import self_intersections

    a = trimesh.creation.icosphere(3, 1.0)
    assert len(self_intersections(a)) == 0
    b = a.copy()
    b.apply_translation([1.0, 0.1, 0.05])
    both = trimesh.util.concatenate([a, b])
    crossing = self_intersections(both)
    # They cross along a circle at x = 0.5: only faces near it.
    centres = both.triangles_center[crossing]
    assert len(crossing) > 40
    assert np.abs(centres[:, 0] - 0.5).max() < 0.25
