"""Test the judges of other tasks with small random models of the real types."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

transformers = pytest.importorskip("transformers")
torch = pytest.importorskip("torch")
Image = pytest.importorskip("PIL.Image")

ROOT = Path(__file__).resolve().parents[2]
JUDGE = ROOT / "python/tt3d_tools/judge.py"
WORDS = ["hen", "teapot", "a", "photo", "of", ".", "hot", "dog"]
sys.path.insert(0, str(JUDGE.parent))
sys.path.insert(0, str(Path(__file__).resolve().parent))
from tool_support import tt3d, write_asset  # noqa: E402


def bert_tokenizer(folder: Path) -> transformers.PreTrainedTokenizerBase:
    specials = ["[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]"]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "vocab.txt").write_text("\n".join(specials + WORDS) + "\n")
    return transformers.BertTokenizer(str(folder / "vocab.txt"))


def save_blip(folder: Path) -> None:
    small = {"hidden_size": 32, "intermediate_size": 32, "num_hidden_layers": 1}
    config = transformers.BlipConfig(
        text_config={
            **small,
            "vocab_size": 13,
            "num_attention_heads": 2,
            "encoder_hidden_size": 32,
            "bos_token_id": 2,
            "eos_token_id": 3,
            "sep_token_id": 3,
            "pad_token_id": 0,
        },
        vision_config={**small, "num_attention_heads": 2, "image_size": 32, "patch_size": 16},
    )
    transformers.BlipForConditionalGeneration(config).save_pretrained(folder)
    images = transformers.BlipImageProcessor(size={"height": 32, "width": 32})
    transformers.BlipProcessor(images, bert_tokenizer(folder)).save_pretrained(folder)


def save_clip(folder: Path) -> None:
    from transformers.models.clip.image_processing_clip import CLIPImageProcessor

    small = {"hidden_size": 32, "intermediate_size": 32, "num_hidden_layers": 1}
    folder.mkdir(parents=True)
    letters = sorted(set("abcdefghijklmnopqrstuvwxyz."))
    tokens = letters + [x + "</w>" for x in letters] + ["<|startoftext|>", "<|endoftext|>"]
    (folder / "vocab.json").write_text(json.dumps({t: i for i, t in enumerate(tokens)}))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    tokenizer = transformers.CLIPTokenizer(str(folder / "vocab.json"), str(folder / "merges.txt"))
    config = transformers.CLIPConfig(
        text_config={
            **small,
            "vocab_size": len(tokens),
            "num_attention_heads": 2,
            "bos_token_id": len(tokens) - 2,
            "eos_token_id": len(tokens) - 1,
        },
        vision_config={**small, "num_attention_heads": 2, "image_size": 32, "patch_size": 16},
        projection_dim=16,
    )
    transformers.CLIPModel(config).save_pretrained(folder)
    images = CLIPImageProcessor(size={"shortest_edge": 32}, crop_size={"height": 32, "width": 32})
    transformers.CLIPProcessor(images, tokenizer).save_pretrained(folder)


def save_dino(folder: Path) -> None:
    backbone = transformers.SwinConfig(
        image_size=64, embed_dim=8, depths=[1, 1, 1, 1], num_heads=[1, 1, 2, 2], window_size=4,
        out_features=["stage2", "stage3", "stage4"],
    )  # fmt: skip
    config = transformers.GroundingDinoConfig(
        backbone_config=backbone,
        text_config={
            "model_type": "bert",
            "vocab_size": 13,
            "hidden_size": 32,
            "num_hidden_layers": 1,
            "num_attention_heads": 2,
            "intermediate_size": 32,
        },
        d_model=32,
        encoder_layers=1,
        decoder_layers=2,
        encoder_attention_heads=2,
        decoder_attention_heads=2,
        encoder_ffn_dim=32,
        decoder_ffn_dim=32,
        num_queries=10,
        num_feature_levels=4,
        max_text_len=32,
    )
    transformers.GroundingDinoForObjectDetection(config).save_pretrained(folder)
    size = {"shortest_edge": 96, "longest_edge": 128}
    images = transformers.GroundingDinoImageProcessor(size=size)
    transformers.GroundingDinoProcessor(images, bert_tokenizer(folder)).save_pretrained(folder)


SAVE = {"caption": save_blip, "zeroshot": save_clip, "detect": save_dino}


def judge(tmp_path: Path, task: str, model: Path) -> subprocess.CompletedProcess[str]:
    pictures = []
    for i in range(2):
        path = tmp_path / f"{i}.png"
        Image.new("RGB", (80, 64), (40 * i, 90, 160)).save(path)
        pictures.append(str(path))
    job = {
        "task": task,
        "model": str(model),
        "pictures": pictures,
        "texts": ["a hen", "a teapot"],
        "threshold": 0.0,
        "out": str(tmp_path / "out.json"),
    }
    (tmp_path / "job.json").write_text(json.dumps(job))
    command = [sys.executable, str(JUDGE), str(tmp_path / "job.json")]
    return subprocess.run(command, capture_output=True, text=True)


@pytest.mark.parametrize("task", SAVE)
def test_a_small_model_answers(tmp_path: Path, task: str) -> None:
    torch.manual_seed(0)
    SAVE[task](tmp_path / "model")
    done = judge(tmp_path, task, tmp_path / "model")
    assert done.returncode == 0, done.stdout + done.stderr
    result = json.loads((tmp_path / "out.json").read_text())
    assert len(result["answers"]) == 2
    assert set(result["shares"]) == {"a hen", "a teapot"}
    if task == "zeroshot":
        assert sum(result["shares"].values()) == pytest.approx(1)
        assert sum(result["answers"][0]["probabilities"]) == pytest.approx(1, abs=1e-5)
    if task == "detect":
        boxes = result["answers"][0]["boxes"]
        assert all(0 <= b["score"] <= 1 and len(b["box"]) == 4 for b in boxes)
        found = any("teapot" in b["label"] for b in boxes)
        assert result["answers"][0]["found"][1] == found
    if task == "caption":
        caption = result["answers"][0]["caption"]
        assert result["answers"][0]["found"] == [w in caption.split() for w in ("hen", "teapot")]


@pytest.mark.parametrize("task", SAVE)
def test_the_command_writes_a_record(tmp_path: Path, task: str) -> None:
    torch.manual_seed(0)
    SAVE[task](tmp_path / "model")
    asset = write_asset(tmp_path)
    done = tt3d("judge", task, asset, "--model", tmp_path / "model", "--text", "a hen. a teapot.",
                "--views", "2", "--size", "64", "--seed", "3",
                "--out", tmp_path / "eval/record.json")  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "a teapot" in done.stdout and "of 2 views" in done.stdout
    record = json.loads((tmp_path / "eval/record.json").read_text())
    assert record["task"] == task and record["asset"] == str(asset)
    assert record["views"] == {"distribution": "dome", "count": 2, "seed": 3, "size": 64}
    assert len(record["answers"]) == 2
    for k, phrase in enumerate(("a hen", "a teapot")):
        found = [answer["found"][k] for answer in record["answers"]]
        assert record["shares"][phrase] == sum(found) / 2


@pytest.mark.parametrize("task", SAVE)
def test_a_missing_folder_names_what_to_download(tmp_path: Path, task: str) -> None:
    done = judge(tmp_path, task, tmp_path / "absent")
    assert done.returncode == 3
    line = done.stdout.strip().splitlines()[-1]
    assert str(tmp_path / "absent") in line and "download" in line


def test_a_broken_folder_is_an_input_error(tmp_path: Path) -> None:
    (tmp_path / "model").mkdir()
    (tmp_path / "model/config.json").write_text("{}")
    assert judge(tmp_path, "caption", tmp_path / "model").returncode == 2


def test_phrases_match_whole_words() -> None:
    from judge import says

    assert says("two hot dogs on a plate", "a hot dog")
    assert says("a teapot.", "teapot")
    assert not says("a henhouse", "a hen")
    assert not says("a dog", "a hot dog")  # the last word alone is another class
    assert says("a hot  dog", "hot dog")
