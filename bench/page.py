"""Helpers for the pages that benchmarks write: sections and tables."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs/benchmarks.md"


def write_section(name: str, text: str) -> None:
    """Write `text` between the marks of section `name`, which docs/benchmarks.md must have."""
    begin, end = f"<!-- bench {name} -->\n", f"\n<!-- end of bench {name} -->"
    pattern = re.compile(re.escape(begin) + ".*?" + re.escape(end), re.DOTALL)
    page = PAGE.read_text(encoding="utf-8")
    changed, count = pattern.subn(lambda _: begin + text + end, page)
    if count != 1:
        raise SystemExit(f"{PAGE}: expected one pair of marks of section {name!r}, found {count}")
    PAGE.write_text(changed, encoding="utf-8")


#: Heading of the section that a person writes; the programs keep it when they write a page again.
READING = "What it says"


def sections(page: str) -> dict[str, str]:
    """Split a page at its second-level headings; the part before the first has the key ""."""
    first, *others = page.split("\n## ")
    return {"": first} | {text.split("\n")[0]: text for text in others}


def reading_of(path: Path) -> str:
    """Return the hand-written section of a page, "" if the page or the section is absent."""
    if not path.is_file():
        return ""
    text = sections(path.read_text(encoding="utf-8")).get(READING, "")
    return text.removeprefix(READING + "\n")


def markdown_table(header: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def processor() -> str:
    """Return the processor's name and its widest vector instructions."""
    lines = dict(
        (part.strip() for part in line.split(":", 1))
        for line in Path("/proc/cpuinfo").read_text().splitlines()
        if ":" in line
    )
    flags = lines.get("flags", "").split()
    vectors = next((n for f, n in (("avx512f", "AVX-512"), ("avx2", "AVX2")) if f in flags), "SSE2")
    return f"{lines.get('model name', 'processor')}, {vectors}"
