"""Make docs/images/transforms.jpg, which shows each transform, with examples/show_transforms.

.venv/bin/python bench/transforms.py build/examples/show_transforms ASSET.glb [PHOTOGRAPHS]

Without PHOTOGRAPHS, the program draws patterns in their place.
"""

import math
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

PAGE = Path(__file__).resolve().parents[1] / "docs/images/transforms.jpg"
ORDER = (
    "none", "object_shift", "light", "scale", "shift", "rotation_deg", "plain_background",
    "photograph_background", "brightness", "contrast", "saturation", "blur", "resolution", "noise",
    "jpeg", "mix", "diversity",
)  # fmt: skip
ROW, LABEL, SHARE = 64, 176, 2


def sheet(folder: Path) -> Image.Image:
    """Return one sheet with the strips and their names, in two columns."""
    names = [name for name in ORDER if (folder / f"{name}.png").exists()]
    rows = (len(names) + SHARE - 1) // SHARE
    strips = [Image.open(folder / f"{name}.png") for name in names]
    width = strips[0].width * ROW // strips[0].height
    page = Image.new("RGB", (SHARE * (LABEL + width), rows * ROW), "white")
    draw, font = ImageDraw.Draw(page), ImageFont.load_default(13)
    for i, (name, strip) in enumerate(zip(names, strips, strict=True)):
        x, y = (i // rows) * (LABEL + width), (i % rows) * ROW
        draw.text((x + 6, y + ROW // 2 - 8), name, fill="black", font=font)
        page.paste(strip.resize((width, ROW), Image.Resampling.LANCZOS), (x + LABEL, y))
    return page


def draw_patterns(folder: Path) -> str:
    """Draw patterns in place of photographs: waves of various colours, directions and widths."""
    folder.mkdir()
    for i in range(6):
        picture = Image.new("RGB", (160, 160))
        angle, width = 0.5 + i, 6 + 5 * i
        for x in range(160):
            for y in range(160):
                wave = math.sin((x * math.cos(angle) + y * math.sin(angle)) / width)
                tone = [
                    128 + 100 * wave * math.sin(i + k) + (x - 80) * (k - 1) / 3 for k in range(3)
                ]
                picture.putpixel((x, y), tuple(round(t) for t in tone))
        picture.save(folder / f"{i}.png")
    return str(folder)


def main() -> None:
    """Run the command line."""
    if len(sys.argv) not in (3, 4):
        sys.exit(__doc__)
    with tempfile.TemporaryDirectory() as folder:
        behind = sys.argv[3] if len(sys.argv) > 3 else draw_patterns(Path(folder) / "patterns")
        subprocess.run([sys.argv[1], sys.argv[2], folder, behind], check=True)
        sheet(Path(folder)).save(PAGE, quality=88)
    print(PAGE)


if __name__ == "__main__":
    main()
