"""Tables of the real robots: Markdown, CSV, and the README's part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from cdm_pin.files import write_text


@dataclass(frozen=True)
class Row:
    """One line of a table: what was done, and the errors."""

    robot: str
    case: str
    step: str
    errors: tuple[float, ...]


@dataclass(frozen=True)
class Chapter:
    """One robot of the report."""

    title: str
    text: str
    columns: tuple[str, ...]
    rows: tuple[Row, ...]


def table_text(chapter: Chapter) -> str:
    """Write a chapter's table in Markdown."""
    head = f"| trained -> judged | model | {' | '.join(chapter.columns)} |"
    rule = "|---|---|" + "---|" * len(chapter.columns)
    body = [f"| {r.case} | {r.step} | {' | '.join(f'{e:.3g}' for e in r.errors)} |" for r in chapter.rows]
    return "\n".join([head, rule, *body])


def document(chapters: Sequence[Chapter]) -> str:
    """Write the page."""
    parts = [
        "# Real robots",
        "Written by `scripts/real_robots.py` from the public recordings that `scripts/get_data.py` gets. Errors are "
        "relative, the norm of the torque error over the norm of the torque, per motor, if no unit is given. The "
        "physics is put in by hand, one named law after the other, to show what it is worth; a law acts along one "
        "coordinate of the motors and conserves power, and friction has no negative coefficient. A law is kept if it "
        "helps the motor it acts on whichever trajectory is fitted.",
    ]
    for chapter in chapters:
        parts += [f"## {chapter.title}", chapter.text, table_text(chapter)]
    return "\n\n".join(parts) + "\n"


def csv_text(chapters: Sequence[Chapter]) -> str:
    """Write all rows as CSV."""
    lines = ["robot,case,model,column,error"]
    for chapter in chapters:
        for row in chapter.rows:
            case, step = row.case.replace(",", ";"), row.step.replace(",", ";")
            lines += [
                f"{row.robot},{case},{step},{name},{error:.4g}"
                for name, error in zip(chapter.columns, row.errors, strict=True)
            ]
    return "\n".join(lines) + "\n"


def write_readme(chapters: Sequence[Chapter], path: Path, begin="<!-- real robots -->", end="<!-- end -->") -> bool:
    """Write published, identified and last rows between two marks of the README; give whether the marks are there."""
    text = path.read_text(encoding="utf-8")
    head, found, rest = text.partition(begin)
    if not found or end not in rest:
        return False
    parts = []
    for chapter in chapters:
        ends = replace(chapter, rows=tuple(_first_and_last(chapter.rows)))
        parts += [f"**{chapter.title}**", table_text(ends)]
    write_text(path, head + begin + "\n" + "\n\n".join(parts) + "\n" + end + rest.partition(end)[2])
    return True


def _first_and_last(rows: Sequence[Row]) -> list[Row]:
    last = rows[-1].step
    published = [row for row in rows if row.step.startswith("published,") or row.case == "published"]
    named = [row for row in rows if row.step.startswith("`cdm-pin identify`")]
    first = [*(published or (rows[:1] if not named else [])), *named]
    return [*first, *(row for row in rows if row.step == last and row not in first)]
