"""Run models of other tasks on pictures: detection, captions, zero-shot classification.

    python judge.py JOB.json

The job has the `task` (detect: Grounding DINO, caption: BLIP, zeroshot: CLIP), the local `model`
folder in the layout of Hugging Face transformers, `pictures`, `texts` (phrases; the first is the
object's true class, the second the target), a `threshold` for boxes, and the JSON file `out`. A
phrase counts as found in a picture by the paper's rule. detect: a box has the phrase. caption: the
word is in the caption. zeroshot: the phrase has the highest probability.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))
import toolkit

MODELS = {
    "detect": ("Grounding DINO", "IDEA-Research/grounding-dino-base"),
    "caption": ("BLIP", "Salesforce/blip-image-captioning-large"),
    "zeroshot": ("CLIP", "openai/clip-vit-base-patch32"),
}
CAPTION_TOKENS = 30
TEXT_THRESHOLD = 0.25  # words below it are left out of a box's phrase; the model's own default


def check_folder(task: str, folder: str) -> None:
    """Raise MissingTool if the model's folder is absent; nothing is downloaded."""
    name, source = MODELS[task]
    if not (Path(folder) / "config.json").is_file():
        raise toolkit.MissingTool(
            f"judge {task} needs a {name} model, e.g. {source} of the Hugging Face hub: download "
            f"its folder (config.json, model.safetensors, tokenizer and preprocessor files) to "
            f"{folder}"
        )


def load(task: str, folder: str) -> tuple[Any, Any]:
    """Load processor and network from a local folder; the weights must be safetensors."""
    transformers = toolkit.need_package("transformers", "judge")
    classes = {
        "detect": transformers.GroundingDinoForObjectDetection,
        "caption": transformers.BlipForConditionalGeneration,
        "zeroshot": transformers.CLIPModel,
    }
    try:
        processor = transformers.AutoProcessor.from_pretrained(folder, local_files_only=True)
        model = classes[task].from_pretrained(folder, local_files_only=True, use_safetensors=True)
    except (OSError, ValueError, KeyError) as error:
        line = str(error).strip().splitlines()[0] if str(error).strip() else repr(error)
        raise toolkit.InputProblem(f"{folder}: not a {MODELS[task][0]} model: {line}") from error
    return processor, model.eval()


def says(text: str, phrase: str) -> bool:
    """Return whether the text has the whole phrase, without its article; a plural counts."""
    words = re.sub(r"^(a|an|the)\s+", "", phrase.lower().strip(" .")).split()
    pattern = r"\s+".join(re.escape(word) for word in words)
    return bool(words) and re.search(rf"\b{pattern}(s|es)?\b", text.lower()) is not None


def detect(processor: Any, model: Any, image: Any, job: dict[str, Any]) -> dict[str, Any]:
    """Return the boxes with their phrases."""
    prompt = " ".join(t.strip(" .").lower() + "." for t in job["texts"])
    inputs = processor(images=image, text=prompt, return_tensors="pt")
    outputs = model(**inputs)
    found = processor.post_process_grounded_object_detection(
        outputs,
        inputs.input_ids,
        threshold=job["threshold"],
        text_threshold=min(TEXT_THRESHOLD, job["threshold"]),
        target_sizes=[image.size[::-1]],
    )[0]
    labels = [str(x) for x in found.get("text_labels") or found["labels"]]
    boxes = [
        {"label": label, "score": float(s), "box": [float(x) for x in b]}
        for label, s, b in zip(labels, found["scores"], found["boxes"], strict=True)
    ]
    return {"boxes": boxes, "found": [any(says(x, t) for x in labels) for t in job["texts"]]}


def caption(processor: Any, model: Any, image: Any, job: dict[str, Any]) -> dict[str, Any]:
    """Return a caption of the picture."""
    inputs = processor(images=image, return_tensors="pt")
    tokens = model.generate(**inputs, max_new_tokens=CAPTION_TOKENS)
    text = processor.decode(tokens[0], skip_special_tokens=True).strip()
    return {"caption": text, "found": [says(text, t) for t in job["texts"]]}


def zeroshot(processor: Any, model: Any, image: Any, job: dict[str, Any]) -> dict[str, Any]:
    """Return the probabilities of the phrases."""
    phrases = [f"a photo of {t.strip(' .')}" for t in job["texts"]]
    inputs = processor(images=image, text=phrases, return_tensors="pt", padding=True)
    p = model(**inputs).logits_per_image.softmax(dim=1)[0]
    best = int(p.argmax())
    return {
        "probabilities": [float(x) for x in p],
        "found": [i == best for i in range(len(phrases))],
    }


ASK = {"detect": detect, "caption": caption, "zeroshot": zeroshot}


def work(arguments: list[str]) -> None:
    """Run the task on all pictures of a job."""
    (path,) = arguments
    job = toolkit.read_job(path)
    task = job["task"]
    check_folder(task, job["model"])
    torch = toolkit.need_package("torch", "judge")
    from PIL import Image

    processor, model = load(task, job["model"])
    answers = []
    with torch.inference_mode():
        for i, name in enumerate(job["pictures"]):
            image = Image.open(name).convert("RGB")
            answers.append(ASK[task](processor, model, image, job))
            toolkit.progress(i + 1, len(job["pictures"]))
    shares = {
        text: sum(a["found"][k] for a in answers) / len(answers)
        for k, text in enumerate(job["texts"])
    }
    result = {"task": task, "model": job["model"], "shares": shares, "answers": answers}
    Path(job["out"]).write_text(json.dumps(result))


if __name__ == "__main__":
    toolkit.main(work)
