"""The plan of scripts/method-table: objects, targets, and attacks, the most informative first."""

from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CAPTURES = ROOT.parent / "shared/data/captures"

#: Objects and their ImageNet classes.
OBJECTS = {"chicken": "hen", "siamese-cat": "284", "soccer-ball": "soccer ball"}
#: Fixed before any attack was run; unrelated to the appearance and name of the objects.
TARGETS = ("teapot", "pineapple")

LITE0 = "efficientnet_lite0"
#: Models of each architecture; the first one is its surrogate.
ARCHITECTURES = {
    "EfficientNet-Lite": (LITE0, "efficientnet_lite1", "efficientnet_lite2"),
    "MobileNetV1": ("mobilenet_v1",),
    "HarDNet-39DS": ("hardnet39ds",),
    "SqueezeNet 1.1": ("squeezenet1_1",),
}
VICTIMS = tuple(model for family in ARCHITECTURES.values() for model in family)
#: Column headings.
SHORT = {
    "efficientnet_lite0": "Lite0", "efficientnet_lite1": "Lite1", "efficientnet_lite2": "Lite2",
    "mobilenet_v1": "MobileNetV1", "hardnet39ds": "HarDNet", "squeezenet1_1": "SqueezeNet",
}  # fmt: skip

#: The paper's table 1. The whole plan shows surrogates 160,000 pictures: three hours, two cores.
METHODS = ("texture", "mesh", "mlp", "grid", "dual", "dual-texture-only", "strong")
#: The methods to compare with; the second target uses only these.
CORE = ("texture", "dual", "strong")
#: Presets after other papers, run on one object.
OTHERS = (
    "advturtle", "meshadv-shape", "meshadv-texture", "physical", "sticker", "full-coverage",
    "repeated", "triplanar",
)  # fmt: skip
BETAS = (100, 1000, 10000)

#: Views a step, where a preset differs from the program's default of 6.
VIEWS_A_STEP = {"strong": 3}
#: Presets that show each picture to one surrogate (attack.ensemble = views).
DEALING = ("strong",)
#: Pictures that several surrogates see together, relative to a single surrogate.
ENSEMBLE_SHARE = 2
#: The same where an architecture is left out. The plain attack it is compared with sees 13 times.
LEFT_OUT_SHARE = 6
#: Methods run longer on one object, to see whether attacks converge and whether they overfit.
LONGER = ("dual", "mesh")
LONGER_SHARE = 4


def views_a_step(method: str) -> int:
    """Return how many pictures a step of the method renders."""
    return VIEWS_A_STEP.get(method, 6)


@dataclass(frozen=True)
class Cell:
    """One attack: its table, its row, and its settings."""

    table: str
    row: str
    method: str
    obj: str
    target: str
    surrogates: tuple[str, ...] = (LITE0,)
    settings: dict[str, str] = field(default_factory=dict, hash=False)
    share: int = 1

    def steps(self, budget: int) -> int:
        """Return the largest number of steps within the budget of pictures."""
        seen_by = 1 if self.method in DEALING else len(self.surrogates)
        return budget * self.share // (views_a_step(self.method) * seen_by)

    @property
    def name(self) -> str:
        """The name of the cell's folder."""
        return f"{self.table}/{self.row}/{self.obj}-{self.target}".replace(" ", "_")


def white_box(left_out: str) -> tuple[str, ...]:
    """Return one model of each architecture except `left_out`; "" leaves none out."""
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
    """The objective of `dual` without floors: only beta sets the balance."""
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


#: Parts of the plan; each is a section of the page.
TABLES = (
    "methods", "longer", "other presets", "second target", "leave-one-out", "ensemble", "beta",
)  # fmt: skip


def plan(presets: tuple[str, ...], objects: tuple[str, ...]) -> list[Cell]:
    """Return the cells of these presets, the most informative first."""

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
