"""What scripts/method-table runs: objects, targets, and the attacks in the order of their worth."""

from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CAPTURES = ROOT.parent / "shared/data/captures"

#: Objects and their ImageNet classes.
OBJECTS = {"chicken": "hen", "siamese-cat": "284", "soccer-ball": "soccer ball"}
#: Fixed before any attack was run; no object's look or name has to do with them.
TARGETS = ("teapot", "pineapple")

LITE0 = "efficientnet_lite0"
#: Models of each architecture, the one that stands for it as a surrogate first.
ARCHITECTURES = {
    "EfficientNet-Lite": (LITE0, "efficientnet_lite1", "efficientnet_lite2"),
    "MobileNetV1": ("mobilenet_v1",),
    "HarDNet-39DS": ("hardnet39ds",),
    "SqueezeNet 1.1": ("squeezenet1_1",),
}
VICTIMS = tuple(model for family in ARCHITECTURES.values() for model in family)
#: As columns are called.
SHORT = {
    "efficientnet_lite0": "Lite0", "efficientnet_lite1": "Lite1", "efficientnet_lite2": "Lite2",
    "mobilenet_v1": "MobileNetV1", "hardnet39ds": "HarDNet", "squeezenet1_1": "SqueezeNet",
}  # fmt: skip

#: The paper's table 1. All of the plan asks surrogates 160,000 times: some three hours, two cores.
METHODS = ("texture", "mesh", "mlp", "grid", "dual", "dual-texture-only", "strong")
#: What the rest is compared with, and what a second target is tried on.
CORE = ("texture", "dual", "strong")
#: The attacks that it builds on, on one object.
OTHERS = (
    "advturtle", "meshadv-shape", "meshadv-texture", "physical", "sticker", "full-coverage",
    "repeated", "triplanar",
)  # fmt: skip
BETAS = (100, 1000, 10000)

#: Views a step: the program's default, and where the preset has another.
VIEWS_A_STEP = {"strong": 3}
#: Presets that show a picture to one of the surrogates, not to all (attack.ensemble = views).
DEALING = ("strong",)
#: How many times as often as one surrogate several may be asked, all together.
ENSEMBLE_SHARE = 2
#: The same where an architecture is left out; the plain attack that it is held to asks 13 times.
LEFT_OUT_SHARE = 6
#: Do attacks settle, and does more of the same overfit? These on one object, with more pictures.
LONGER = ("dual", "mesh")
LONGER_SHARE = 4


def views_a_step(method: str) -> int:
    """Return how many pictures a step of the method renders."""
    return VIEWS_A_STEP.get(method, 6)


@dataclass(frozen=True)
class Cell:
    """One attack: its table, the row in it, and what the program is told."""

    table: str
    row: str
    method: str
    obj: str
    target: str
    surrogates: tuple[str, ...] = (LITE0,)
    settings: dict[str, str] = field(default_factory=dict, hash=False)
    share: int = 1

    def steps(self, budget: int) -> int:
        """Return the steps in which the surrogates see at most as many pictures as they may."""
        seen_by = 1 if self.method in DEALING else len(self.surrogates)
        return budget * self.share // (views_a_step(self.method) * seen_by)

    @property
    def name(self) -> str:
        """The cell's folder."""
        return f"{self.table}/{self.row}/{self.obj}-{self.target}".replace(" ", "_")


def white_box(left_out: str) -> tuple[str, ...]:
    """Return a model of each architecture but one; of all where none is named."""
    return tuple(family[0] for name, family in ARCHITECTURES.items() if name != left_out)


def _methods(
    table: str, methods: tuple[str, ...], objects: tuple[str, ...], target: str
) -> list[Cell]:
    return [Cell(table, m, m, o, target) for m in methods for o in objects]


def _leave_one_out(methods: tuple[str, ...], objects: tuple[str, ...], target: str) -> list[Cell]:
    return [
        Cell("leave-one-out", f"{m} without {left_out}", m, o, target, white_box(left_out),
             share=LEFT_OUT_SHARE)
        for o in objects
        for left_out in ARCHITECTURES
        for m in methods
    ]  # fmt: skip


def _betas(objects: tuple[str, ...], target: str) -> list[Cell]:
    """The paper's objective: no floors, beta alone weighs."""
    return [
        Cell("beta", f"beta {beta}", "dual", o, target, settings={
            "attack.beta": str(beta), "attack.psnr_floor": "0", "attack.ssim_floor": "0",
        })
        for beta in BETAS
        for o in objects
    ]  # fmt: skip


def _longer(methods: tuple[str, ...], objects: tuple[str, ...], target: str) -> list[Cell]:
    return [Cell("longer", m, m, o, target, share=LONGER_SHARE) for m in methods for o in objects]


def _ensemble(methods: tuple[str, ...], objects: tuple[str, ...], target: str) -> list[Cell]:
    return [
        Cell("ensemble", m, m, o, target, white_box(""), share=ENSEMBLE_SHARE)
        for m in methods
        for o in objects
    ]


#: Parts of the plan, each a section of the page.
TABLES = (
    "methods", "longer", "other presets", "second target", "leave-one-out", "ensemble", "beta",
)  # fmt: skip


def plan(presets: tuple[str, ...], objects: tuple[str, ...]) -> list[Cell]:
    """Return the cells of these presets, those first without which the table says least."""

    def asked(*methods: str) -> tuple[str, ...]:
        return tuple(m for m in methods if m in presets)

    first, second = TARGETS
    own, others = asked(*METHODS), asked(*OTHERS)
    cells = _methods("methods", asked(*CORE), objects, first)
    cells += _leave_one_out(asked("strong"), objects, first)
    cells += _methods("methods", tuple(m for m in own if m not in CORE), objects, first)
    if "dual" in own:
        cells += _betas(objects[:1], first)
    cells += _methods("other presets", others, objects[:1], first)
    cells += _methods("second target", asked(*CORE), objects, second)
    cells += _longer(asked(*LONGER), objects[:1], first)
    return cells + _ensemble(asked("strong", "texture"), objects, first)
