"""Compare PSNR and SSIM with scikit-image, LPIPS with lpips, and distances with known surfaces."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

np = pytest.importorskip("numpy")
trimesh = pytest.importorskip("trimesh")

TOOLS = Path(__file__).resolve().parents[2] / "python/tt3d_tools"
sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(TOOLS))
from tool_support import PROGRAM, TOY, tt3d, write_asset  # noqa: E402


def over_white(path: Path) -> np.ndarray:
    """Read a rendered view, composited over white, [H,W,3] in [0,1]."""
    from PIL import Image

    rgba = np.asarray(Image.open(path).convert("RGBA"), np.float64) / 255
    return rgba[..., :3] * rgba[..., 3:] + 1 - rgba[..., 3:]


@pytest.mark.skipif(not PROGRAM.exists(), reason=f"{PROGRAM} is not built")
def test_psnr_and_ssim_agree_with_scikit_image(tmp_path: Path) -> None:
    """Compare the figures of an evaluation with scikit-image on the same rendered views."""
    metrics = pytest.importorskip("skimage.metrics")
    from PIL import Image

    clean, attacked = write_asset(tmp_path, "clean"), write_asset(tmp_path, "attacked")
    texels = np.asarray(Image.open(attacked.with_suffix(".png")), np.float64)
    noise = np.random.default_rng(4).normal(0, 40, (64, 64, 3)).repeat(4, 0).repeat(4, 1)
    changed = np.round(np.clip(texels + noise, 0, 255)).astype(np.uint8)
    Image.fromarray(changed).save(attacked.with_suffix(".png"))
    views = ["--views", 5, "--size", 128, "--seed", 7]
    done = tt3d("evaluate", attacked, "--clean", clean, "--target", 0, "--victims", TOY, *views,
                "--out", tmp_path / "record.json")  # fmt: skip
    assert done.returncode == 0, done.stderr
    for asset in (clean, attacked):
        done = tt3d("render", asset, *views, "--out", tmp_path / asset.stem)
        assert done.returncode == 0, done.stderr
    psnr, gaussian, uniform = [], [], []
    for file in sorted((tmp_path / "clean/test").glob("*.png")):
        a, b = over_white(file), over_white(tmp_path / "attacked/test" / file.name)
        psnr.append(metrics.peak_signal_noise_ratio(a, b, data_range=1))
        options = {"channel_axis": 2, "data_range": 1}
        uniform.append(metrics.structural_similarity(a, b, **options))
        # The settings of Wang et al. (2004): a Gaussian of sigma 1.5 over 11 pixels.
        options |= {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
        gaussian.append(metrics.structural_similarity(a, b, **options))
    assert len(psnr) == 5
    found = json.loads((tmp_path / "record.json").read_text())["naturalness"]
    assert found["psnr"] == pytest.approx(np.mean(psnr), abs=1e-3)
    assert found["ssim"] == pytest.approx(np.mean(gaussian), abs=1e-4)
    # The test must be able to tell the windows apart.
    assert abs(np.mean(uniform) - np.mean(gaussian)) > 1e-3


@pytest.mark.parametrize("net", ["vgg", "alex", "squeeze"])
def test_lpips_agrees_with_the_package(tmp_path: Path, net: str) -> None:
    """The backbone is random and comes from a file with torchvision's keys."""
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


@pytest.mark.skipif(not PROGRAM.exists(), reason=f"{PROGRAM} is not built")
def test_evaluate_measures_lpips(tmp_path: Path) -> None:
    """From the command to the record; the value equals that of the package on the same views."""
    lpips = pytest.importorskip("lpips")
    torch = pytest.importorskip("torch")
    torchvision = pytest.importorskip("torchvision")
    torch.manual_seed(1)
    backbone = torchvision.models.squeezenet1_1(weights=None)
    torch.save(backbone.state_dict(), tmp_path / "net.pth")
    clean, attacked = write_asset(tmp_path, "clean"), write_asset(tmp_path, "attacked")
    from PIL import Image

    Image.open(clean.with_suffix(".png")).rotate(180).save(attacked.with_suffix(".png"))
    views = ["--views", 2, "--size", 96, "--seed", 7]
    words = ["evaluate", attacked, "--clean", clean, "--target", 0, "--victims", TOY, *views,
             "--out", tmp_path / "r.json", "--lpips", "squeeze"]  # fmt: skip
    missing = tt3d(*words, "--lpips-backbone", tmp_path / "absent.pth")
    assert missing.returncode == 3 and "absent.pth" in missing.stderr
    done = tt3d(*words, "--lpips-backbone", tmp_path / "net.pth")
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "r.json").read_text())["naturalness"]
    assert found["lpips_net"] == "squeeze"
    network = lpips.LPIPS(net="squeeze", pnet_rand=True, verbose=False).eval()
    layers = dict(backbone.features.named_parameters())
    with torch.no_grad():
        for name, value in network.net.named_parameters():
            value.copy_(layers[name.split(".", 1)[1]])
    for asset in (clean, attacked):
        tt3d("render", asset, *views, "--out", tmp_path / asset.stem)
    distances = []
    for file in sorted((tmp_path / "clean/test").glob("*.png")):
        pair = (over_white(file), over_white(tmp_path / "attacked/test" / file.name))
        a, b = (torch.tensor(p * 2 - 1).float().permute(2, 0, 1)[None] for p in pair)
        with torch.no_grad():
            distances.append(float(network(a, b)))
    assert len(distances) == 2 and min(distances) > 0
    assert found["lpips"] == pytest.approx(np.mean(distances), abs=1e-3)


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


def test_the_distance_of_concentric_spheres_is_the_difference_of_their_radii() -> None:
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


def test_a_spike_changes_hausdorff_more_than_chamfer() -> None:
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
    # The spheres cross along a circle at x = 0.5, so only faces near it count.
    centres = both.triangles_center[crossing]
    assert len(crossing) > 40
    assert np.abs(centres[:, 0] - 0.5).max() < 0.25
