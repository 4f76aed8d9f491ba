"""What `cdm-pin diagnose` says of recordings of real robots, word by word, written to docs/real_diagnoses.md.

Usage: scripts/real_diagnoses.py [-o docs/real_diagnoses.md]

The recordings are where CDM_PIN_DATA says or scripts/get_data.py puts them.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from real_identify import halves
from real_robots import data_folder

from cdm_pin.console import output
from cdm_pin.diagnose import diagnose
from cdm_pin.errors import CdmError
from cdm_pin.files import write_text
from cdm_pin.model import CableModel, load_model
from cdm_pin.recording import Recording, load_recording
from cdm_pin.units import either
from cdm_pin.wording import candidate, quantity, sentence

ROOT = Path(__file__).resolve().parent.parent
REAL = ROOT / "urdf" / "real"


@dataclass(frozen=True)
class Case:
    """A robot and its recordings: the layout is that of the file in urdf/real/recordings, for each of the files.

    With `share`, the first part of each run is learned from and the rest is unseen.
    """

    title: str
    robot: str
    layout: str
    runs: tuple[str, ...]
    unseen: tuple[str, ...] = ()
    known: str = ""
    share: float = 0.0


CASES = (
    Case(
        "da Vinci patient-side manipulator, trained on `one`, judged on `two`",
        "psm",
        "dvrk_psm_wpi",
        ("one_results.csv.gz",),
        ("two_results.csv.gz",),
        "Published: springs at roll and at the wrist's cables, friction between the fingers, rotor inertia.",
    ),
    Case(
        "da Vinci patient-side manipulator, first three joints",
        "psm3",
        "dvrk_psm_3dof_gondokaryono",
        ("psm1_fourier_test2_results.csv.gz", "psm1_fourier_test3_results.csv.gz"),
        ("psm1_fourier_test4_results.csv.gz",),
        "Friction of the insertion axis was measured at constant speeds.",
    ),
    Case(
        "da Vinci master manipulator",
        "mtm",
        "dvrk_mtm_wpi",
        ("one_results.csv.gz",),
        (),
        "Published: a wrist spring and the torque of an electrical cable. One run: its first 60 % and the rest, which "
        "repeats part of the motion.",
        0.6,
    ),
    Case("Barrett WAM", "wam", "wam_2dof_noohian", ("state_4_gravity_4.csv.gz",), (), "One short run."),
    Case(
        "Franka Panda (control)",
        "panda",
        "franka_panda_gaz",
        ("trajectory_1.csv.gz",),
        (),
        "No cables: only friction of gears is to be expected. One run: its first 60 % and the rest.",
        0.6,
    ),
    Case(
        "da Vinci wrist, two positions",
        "psm_serial",
        "dvrk_wrist_hysteresis_berkeley",
        ("random",),
        (),
        "Commanded against camera-measured angles at rest, no torque. Published: stretch, hysteresis and coupling "
        "between the wrist's joints. Its first 70 % and the rest.",
        0.7,
    ),
    Case(
        "da Vinci tool, both cable ends measured",
        "davinci_tool",
        "davinci_tool_mrd",
        ("Tool_4_Maryland_L_4/00.TXT.gz", "Tool_4_Maryland_L_4/04.TXT.gz"),
        ("Tool_4_Maryland_L_4/09.TXT.gz",),
        "Friction along the cable path and a cable that stretches; the torque of the jaw is not told to the command.",
    ),
)


def recording(case: Case, name: str, model: Any, folder: Path):
    """Read one file by the case's layout."""
    content = yaml.safe_load((REAL / "recordings" / f"{case.layout}.yaml").read_text(encoding="utf-8"))
    if "files" in content:
        content["files"] = {k: str(data_folder() / case.layout / f"{name}_{k}_raw.npy") for k in content["files"]}
    else:
        content["file"] = str(data_folder() / case.layout / name)
    path = folder / f"{name.replace('/', '_')}.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return load_recording(path, model)


def parts(case: Case, model: CableModel) -> tuple[list[Recording], list[Recording]]:
    """Give the recordings to learn from and the unseen ones."""
    with tempfile.TemporaryDirectory() as folder:
        runs, unseen = ([recording(case, n, model, Path(folder)) for n in names] for names in (case.runs, case.unseen))
    if case.share:
        cut = [halves(run, case.share) for run in runs]
        runs, unseen = [first for first, _ in cut], [rest for _, rest in cut]
    return runs, unseen


def chapter(case: Case) -> str:
    """Diagnose one robot and put it into words."""
    model = load_model(REAL / f"{case.robot}.yaml")
    runs, unseen = parts(case, model)
    content = diagnose(model, runs, unseen).content
    lines = [f"## {case.title}", "", case.known, "", f"> {sentence(content)}", ""]
    if content.get("reason"):
        return "\n".join([*lines, f"It declines: {content['reason']}.", ""])
    lines += _errors(content)
    for item in content["findings"]:
        sizes = ", ".join(f"{name} {quantity(value)}" for name, value in item["parameters"].items())
        rivals = "; ".join(candidate(other) for other in item["indistinguishable_from"])
        beside = f" Not told from: {rivals}." if rivals else ""
        unsure = " Unconfirmed." if item.get("unconfirmed") else ""
        lines.append(f"- {candidate(item)}: {sizes}; BIC {item['evidence']['delta_bic']:.0f}.{beside}{unsure}")
    if content["unexplained"]:
        nearest = "; ".join(candidate(other) for other in content["unexplained"]["nearest"]) or "nothing"
        lines.append(f"- Not named: {content['unexplained']['region']}. Nearest, but not it: {nearest}.")
    return "\n".join([*lines, ""])


def _errors(content: dict[str, Any]) -> list[str]:
    where = "holdout" if content["fit"]["holdout"] else "train"
    fit, unit = content["fit"][where], either(np.atleast_1d(content["fit"]["unit"]))
    rows = [("rigid body", "rmse_rigid"), ("completed", "rmse_augmented"), ("noise floor", "noise_floor")]
    width = len(fit["rmse_rigid"])
    head = f"| {'unseen' if where == 'holdout' else 'training'} [{unit}] | " + " | ".join(
        f"m{i + 1}" for i in range(width)
    )
    body = [f"| {name} | " + " | ".join(f"{x:.3g}" for x in fit[key]) + " |" for name, key in rows]
    band = content["data"]["band"][1]
    return [f"{head} |", "|---|" + "---|" * width, *body, "", f"Band up to {band:.2g} Hz.", ""]


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the document."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", default=str(ROOT / "docs" / "real_diagnoses.md"))
    args = parser.parse_args(arguments)
    parts = [
        "# What `cdm-pin diagnose` says of real robots",
        "",
        "Written by `scripts/real_diagnoses.py`: nothing was told to the command but the robot's file (bodies and",
        "published structure, no friction) and the recordings. Each heading: what is known of the robot, then what",
        "the command says, and the errors in the band it chose.",
        "",
    ]
    try:
        for case in CASES:
            output().print(case.title)
            parts.append(chapter(case))
    except CdmError as exc:
        print(f"real_diagnoses: {exc}", file=sys.stderr)
        return 2
    write_text(Path(args.output), "\n".join(parts))
    return 0


if __name__ == "__main__":
    sys.exit(main())
