"""The names of a recording's columns, and what a misspelt one was meant to be."""

from __future__ import annotations

import re
from collections.abc import Sequence

JOINT_QUANTITIES = ("joint_position", "joint_velocity", "joint_acceleration", "joint_torque", "joint_position_desired")
MOTOR_QUANTITIES = ("motor_position", "motor_velocity", "motor_acceleration", "motor_torque")
CABLE_QUANTITIES = ("cable_tension_upper", "cable_tension_lower")
QUANTITIES = (*JOINT_QUANTITIES, *MOTOR_QUANTITIES, *CABLE_QUANTITIES)


def is_known_column(name: str) -> bool:
    """Tell whether a name is `time` or `<quantity>_<i>` with i = 1, 2, ..."""
    stem, _, index = name.rpartition("_")
    return name == "time" or (stem in QUANTITIES and re.fullmatch("[1-9][0-9]*", index) is not None)


def misspelt(name: str, others: Sequence[str] = ()) -> str | None:
    """Give the known column that `name` looks like a misspelling of, if it does.

    Two slips of the pen in a quantity, one in `time`, other case or separators, and a missing, zero or padded index
    count as misspelling; so do abbreviations (joint_pos_1), unless the full name is among the `others`.
    """
    match = re.fullmatch(r"(.*?)[\s_.\-\[(]*(\d*)[\])]?", name.strip())
    stem, digits = match.groups() if match else (name, "")
    plain = re.sub(r"[^a-z]+", "_", stem.lower()).strip("_")
    if not digits and _slips(plain, "time") <= 1:
        return "time"
    meant = min(QUANTITIES, key=lambda known: _slips(plain, known))
    index = f"_{max(int(digits or 1), 1)}"
    if _slips(plain.replace("_", ""), meant.replace("_", "")) <= 2 or plain in (meant + "s", meant[:-1] + "ies"):
        return meant + index
    for known in QUANTITIES:
        parts, words = plain.split("_"), known.split("_")
        short = len(parts) == len(words) and all(
            len(p) >= 3 and w.startswith(p) for p, w in zip(parts, words, strict=False)
        )
        if short and known + index not in others:
            return known + index
    return None


def _slips(a: str, b: str) -> int:
    """Count the letters to add, drop, change or swap with a neighbour to turn `a` into `b`."""
    if abs(len(a) - len(b)) > 2:
        return 3
    rows = [list(range(len(b) + 1))]
    for i, x in enumerate(a, 1):
        row = [i]
        for j, y in enumerate(b, 1):
            cost = min(rows[-1][j] + 1, row[j - 1] + 1, rows[-1][j - 1] + (x != y))
            if i > 1 and j > 1 and x == b[j - 2] and a[i - 2] == y:
                cost = min(cost, rows[-2][j - 2] + 1)
            row.append(cost)
        rows.append(row)
    return rows[-1][-1]
