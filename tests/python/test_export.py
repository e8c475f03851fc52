"""Test the exporters: packages, weights, cards. tests/model and test_zoo.py test the reader."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "python"))

from tool_support import tt3d  # noqa: E402
from tt3d_tools import export  # noqa: E402
from tt3d_tools.package import ModelSpec, file_sha256, write_package  # noqa: E402
from tt3d_tools.probe import gradient_positions, probe_images  # noqa: E402
from tt3d_tools.weights import WeightsError, load_weights  # noqa: E402
from tt3d_tools.zoo import build_named  # noqa: E402


def small_network() -> torch.nn.Module:
    torch.manual_seed(0)
    return torch.nn.Sequential(
        torch.nn.Conv2d(3, 4, 3), torch.nn.AdaptiveAvgPool2d(1), torch.nn.Flatten(),
        torch.nn.Linear(4, 3),
    )  # fmt: skip


def small_spec(name: str = "small") -> ModelSpec:
    return ModelSpec(
        name=name,
        model=small_network(),
        architecture="small",
        source="test",
        licence="MIT",
        input_size=(8, 8),
        resize=8,
        interpolation="bilinear",
        mean=(0.5, 0.5, 0.5),
        std=(0.5, 0.5, 0.5),
        labels=["a", "b", "c"],
    )


def run_tool(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", *arguments],
        cwd=ROOT / "python",
        capture_output=True,
        text=True,
    )


def test_package_has_the_answers_of_pytorch(tmp_path: Path) -> None:
    archive, card_path = write_package(small_spec(), tmp_path, (1, 3))
    card = json.loads(card_path.read_text())
    assert card["sha256"] == file_sha256(archive)
    assert [case["batch"] for case in card["probe"]["cases"]] == [1, 3]
    program = torch.export.load(archive).module()
    for case in card["probe"]["cases"]:
        images = probe_images(case["batch"], 8, 8, card["probe"]["seed"])
        logits = program((images - 0.5) / 0.5)
        assert torch.allclose(logits, torch.tensor(case["logits"]), atol=1e-5)
        assert len(case["gradient"]) == 256


def test_export_leaves_no_temporary_files_and_no_paths(tmp_path: Path) -> None:
    archive, card = write_package(small_spec(), tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == [card.name, archive.name]
    assert str(ROOT).encode() not in archive.read_bytes()


def test_a_network_without_classes_is_refused() -> None:
    pytest.importorskip("timm")
    with pytest.raises(WeightsError, match="features, not classes"):
        build_named("timm:eva02_tiny_patch14_224", "none")


def test_failed_export_leaves_no_partial_package(tmp_path: Path) -> None:
    class Loop(torch.nn.Module):
        def forward(self, x: torch.Tensor) -> torch.Tensor:
            return x.mean((2, 3)) * float(x.sum().item() > 0)

    spec = small_spec()
    spec.model = Loop()
    with pytest.raises(Exception, match=r".*"):
        write_package(spec, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_probe_rule_is_fixed() -> None:
    images = probe_images(2, 4, 5, 1)
    assert images.shape == (2, 3, 4, 5)
    assert float(images.min()) >= 0 and float(images.max()) <= 1
    assert torch.equal(images[:1], probe_images(1, 4, 5, 1))
    assert not torch.equal(images, probe_images(2, 4, 5, 2))
    assert all(0 <= p < 100 for p in gradient_positions(100, 50, 1))


@pytest.mark.parametrize("prefix", ["", "module.", "model.", "module.model."])
def test_weights_with_common_prefixes(tmp_path: Path, prefix: str) -> None:
    source, target = small_network(), small_network()
    with torch.no_grad():
        source[0].weight.add_(1)
    path = tmp_path / "weights.pth"
    torch.save({"state_dict": {prefix + k: v for k, v in source.state_dict().items()}}, path)
    load_weights(target, path)
    assert torch.equal(source[0].weight, target[0].weight)


def test_safetensors_weights(tmp_path: Path) -> None:
    from safetensors.torch import save_file

    path = tmp_path / "weights.safetensors"
    save_file(small_network().state_dict(), path)
    load_weights(small_network(), path)


def test_mismatched_weights_are_listed(tmp_path: Path) -> None:
    state = small_network().state_dict()
    state["extra"] = state.pop("3.bias")
    state["0.bias"] = torch.zeros(5)
    path = tmp_path / "weights.pth"
    torch.save(state, path)
    with pytest.raises(WeightsError) as error:
        load_weights(small_network(), path)
    for part in ("missing: 3.bias", "unknown: extra", "0.bias (5,) instead of (4,)"):
        assert part in str(error.value)


def test_checkpoints_that_run_code_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "weights.pth"
    torch.save(small_network(), path)
    with pytest.raises(WeightsError, match="not a checkpoint of plain tensors"):
        load_weights(small_network(), path)


def test_the_error_of_missing_weights_names_their_path(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from tt3d_tools.zoo import build_named

    def offline(*_: object, **__: object) -> None:
        raise OSError("no network")

    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    monkeypatch.setattr(torch.hub, "download_url_to_file", offline)
    with pytest.raises(WeightsError) as error:
        build_named("mobilenet_v2", None)
    for part in ("mobilenet_v2-b0353104.pth", str(tmp_path), "--weights"):
        assert part in str(error.value)


def test_unknown_name() -> None:
    from tt3d_tools.zoo import build_named

    with pytest.raises(WeightsError, match="--list"):
        build_named("resnet5O", None)


def test_own_network_from_the_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "own_net.py").write_text(
        "import torch\n\n\ndef build():\n"
        "    return torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(192, 3))\n"
    )
    (tmp_path / "names.txt").write_text("cat\ndog\nbird\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    arguments = ["own_net:build", "--out", str(tmp_path / "models"), "--size", "8",
                 "--mean", ".5", ".5", ".5", "--std", ".5", ".5", ".5",
                 "--labels", str(tmp_path / "names.txt"), "--program", "absent"]  # fmt: skip
    monkeypatch.setattr(sys, "argv", ["export", *arguments])
    assert export.main() == 0
    card = json.loads((tmp_path / "models/own_net.json").read_text())
    assert card["labels"] == ["cat", "dog", "bird"]


def test_card_for_a_foreign_archive(tmp_path: Path) -> None:
    archive, card_path = write_package(small_spec(), tmp_path)
    card_path.unlink()
    done = run_tool("tt3d_tools.card", str(archive), "--mean", ".4", ".4", ".4", "--std", ".2",
                    ".2", ".2", "--size", "8", "8")  # fmt: skip
    assert done.returncode == 0, done.stderr
    card = json.loads(card_path.read_text())
    assert card["mean"] == [0.4, 0.4, 0.4]
    assert card["sha256"] == file_sha256(archive)
    again = run_tool("tt3d_tools.card", str(archive), "--mean", "0", "0", "0", "--std", "1", "1",
                     "1", "--size", "8")  # fmt: skip
    assert again.returncode == 2 and "--force" in again.stderr


def spec_that_ends_in(layer: torch.nn.Module) -> ModelSpec:
    spec = small_spec()
    spec.model = torch.nn.Sequential(spec.model, layer)
    return spec


def test_a_network_that_ends_in_softmax_is_refused_at_export(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="--scores none"):
        write_package(spec_that_ends_in(torch.nn.Softmax(1)), tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("layer", "word"), [(torch.nn.Softmax(1), "softmax"),
                                             (torch.nn.Sigmoid(), "sigmoid")])  # fmt: skip
def test_the_program_refuses_probabilities_in_place_of_logits(
    tmp_path: Path, layer: torch.nn.Module, word: str
) -> None:
    spec = spec_that_ends_in(layer)
    spec.scores = "none"
    archive, card_path = write_package(spec, tmp_path)
    accepted = tt3d("model", "check", str(archive), "--json")
    assert accepted.returncode == 0, accepted.stderr
    assert json.loads(accepted.stdout)["scores"] == "none"
    card = json.loads(card_path.read_text())
    del card["scores"]
    card_path.write_text(json.dumps(card))
    refused = tt3d("model", "check", str(archive))
    assert refused.returncode == 2
    assert f"ends in a {word}" in refused.stderr and '"scores": "none"' in refused.stderr


def test_probabilities_are_not_turned_into_probabilities_again(tmp_path: Path) -> None:
    from PIL import Image

    spec = spec_that_ends_in(torch.nn.Softmax(1))
    spec.scores = "none"
    archive, _ = write_package(spec, tmp_path)
    Image.new("RGB", (8, 8), (255, 128, 0)).save(tmp_path / "p.png")
    done = tt3d("model", "classify", str(archive), str(tmp_path / "p.png"), "--json")
    assert done.returncode == 0, done.stderr
    shown = {c["name"]: c["probability"] for c in json.loads(done.stdout)["images"][0]["top"]}
    color = (torch.tensor([255.0, 128.0, 0.0]) / 255 - 0.5) / 0.5
    picture = color[None, :, None, None].expand(1, 3, 8, 8)
    expected = spec.model(picture)[0].tolist()
    assert [shown[name] for name in "abc"] == pytest.approx(expected, abs=1e-5)


def test_labels_of_keras_and_of_plain_objects(tmp_path: Path) -> None:
    path = tmp_path / "labels.json"
    path.write_text('{"1": ["n2", "magpie"], "0": ["n1", "robin"]}')
    assert export.parse_labels(str(path)) == ["robin", "magpie"]
    path.write_text('{"0": "robin", "1": "magpie"}')
    assert export.parse_labels(str(path)) == ["robin", "magpie"]
    path.write_text('{"robin": 0, "magpie": 1}')
    with pytest.raises(WeightsError, match="expected a list of names"):
        export.parse_labels(str(path))
    path.write_text("[1, 2]")
    with pytest.raises(WeightsError, match="name of a class"):
        export.parse_labels(str(path))


def test_mean_and_std_in_bytes_are_refused(tmp_path: Path) -> None:
    archive, card_path = write_package(small_spec(), tmp_path)
    done = run_tool("tt3d_tools.card", str(archive), "--force", "--size", "8", "--mean", "123.675",
                    "116.28", "103.53", "--std", "58.395", "57.12", "57.375")  # fmt: skip
    assert done.returncode == 2
    assert "--mean 0.485 0.456 0.406 --std 0.229 0.224 0.225" in done.stderr
    card = json.loads(card_path.read_text())
    card["std"] = [255, 255, 255]
    card_path.write_text(json.dumps(card))
    refused = tt3d("model", "check", str(archive))
    assert refused.returncode == 2 and "'std' is for pictures in [0,255]" in refused.stderr
