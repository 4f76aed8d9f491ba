"""Show what the project does: a hidden fault found blind, then geometry in and torques out, on paper and on a real arm.

Usage: ./scripts/demo [-o FOLDER] [--seed N]
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import yaml

from cdm_pin.cables import cable_forces
from cdm_pin.console import output, table
from cdm_pin.dynamics import motor_torques
from cdm_pin.files import write_text
from cdm_pin.manipulator import load_manipulator
from cdm_pin.model import build_model, load_model
from cdm_pin.plant.draw import draw
from cdm_pin.recording import Recording, load_recording, save_recording
from cdm_pin.scoring import describe, describe_sizes, score
from cdm_pin.torques import recorded_torques, rms
from cdm_pin.urdf import generate_urdf
from cdm_pin.urdf_check import urdf_deviation

ROOT = Path(__file__).resolve().parent.parent
SAY = output().print


def data_folder() -> Path | None:
    """Find the public recordings: CDM_PIN_DATA, else ./data, else ../shared/data."""
    named = os.environ.get("CDM_PIN_DATA")
    folders = [Path(named)] if named else [ROOT / "data", ROOT.parent / "shared" / "data"]
    return next((folder for folder in folders if (folder / "dvrk_psm_3dof_gondokaryono").is_dir()), None)


def blind_trial(folder: Path, seed: int) -> None:
    """Let an independent plant hide a fault, hand over its recordings alone, and open the seal after the verdict."""
    SAY(f"\n1. A fault is hidden in a simulated arm (seed {seed}); only recordings and a wrong model are handed over\n")
    trial = draw(seed, n_links=2, effects=1)
    files = trial.write(folder / "blind")
    seal = hashlib.sha256(files["truth"].read_bytes()).hexdigest()
    SAY(f"sealed truth: sha256 {seal}")
    out = folder / "blind" / "diagnosis"
    command = [sys.executable, "-m", "cdm_pin.cli", "diagnose", files["manipulator"], *files["recordings"]]
    for path in files["holdout"]:
        command += ["--holdout", path]
    subprocess.run([*map(str, command), "-o", str(out)], check=True)

    assert hashlib.sha256(files["truth"].read_bytes()).hexdigest() == seal
    truth = json.loads(files["truth"].read_text())
    diagnosis = json.loads((out / "diagnosis.json").read_text())
    for effect in truth["effects"]:
        place, sizes = describe(effect["location"]), describe_sizes(effect["parameters"])
        SAY(f"\nThe seal is open: {effect['effect']} at {place}, {sizes}")
    result = score(truth, diagnosis)
    false = f", false: {', '.join(result.false_findings)}" if result.false_findings else ", nothing false beside it"
    SAY(f"Met: {', '.join(result.meetings)}{false}. The evidence: {out / 'report.html'}")


def paper_arm(folder: Path) -> None:
    """Go from the pulley geometry of the paper's Table 1 to a URDF and to torques, tensions and forces."""
    manipulator = load_manipulator(ROOT / "urdf" / "cdm2.yaml")
    theta = np.degrees(manipulator.pulleys.wrap_half_angle[0])
    SAY("\n2. The paper's arm: pulley geometry in, URDF and motor torques out\n")
    SAY(f"eq. (1): theta_j0 = {90 - theta:.4f} deg, so each joint may turn by +-{2 * theta:.2f} deg")

    text = generate_urdf(manipulator)
    write_text(folder / "cdm2.urdf", text)
    deviation = max(urdf_deviation(text, manipulator).values())
    SAY(f"{folder / 'cdm2.urdf'}: read back with Pinocchio and yourdfpy, equal to {deviation:.0e}")

    model = build_model(manipulator)
    t = np.arange(0, 6, 0.005)
    w = np.array([1.2, 2.1])
    q = np.array([0.9, 1.2]) * np.sin(w * t[:, None])
    v, a = np.array([0.9, 1.2]) * w * np.cos(w * t[:, None]), -w * w * q
    tau_m = motor_torques(model, q, v, a)
    save_recording(Recording(t, {"joint_position": q, "motor_torque": tau_m}), folder / "cdm2.csv")
    SAY(f"eqs (53), (54) against the general code: {np.abs(tau_m - printed_torques(q, v, a)).max():.0e} N m apart")

    forces = cable_forces(model, q, v, a)
    tension, hinge = forces.state.tension, np.linalg.norm(forces.hinge, axis=-1)
    loads = forces.bearing_load()
    rows = [
        [
            i + 1,
            np.abs(tau_m[:, i]).max(),
            tension[:, i].min(),
            tension[:, i].max(),
            hinge[:, i].max(),
            max(load.max() for key, load in loads.items() if key[1] == i + 1),
        ]
        for i in range(2)
    ]
    header = ("motor", "peak torque [N m]", "tension from [N]", "to [N]", "hinge, peak [N]", "bearing, peak [N]")
    SAY(table(f"Along {folder / 'cdm2.csv'}, pretension {manipulator.pretension:g} N per side", header, rows))
    for warning in forces.state.warnings():
        SAY(warning)


def printed_torques(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Compute eqs (53) and (54) as the paper prints them."""
    (t1, t2), (w1, w2), (a1, a2) = q.T, v.T, a.T
    c2, s2 = np.cos(t2), np.sin(t2)
    first = 0.6 * a1 + 0.18 * c2 * (a1 + a2) - 0.18 * s2 * (w1**2 + w2**2) - 0.36 * w1 * w2 * s2 + 11.76 * np.cos(t1)
    second = 0.12 * (a1 + a2) + 0.18 * a1 * c2 + 0.18 * w1**2 * s2 + 2.94 * np.cos(t1 + t2)
    return np.column_stack([first, second])


def real_arm(folder: Path, data: Path) -> None:
    """Compute what a guessed model of a real surgical arm asks of its motors along a recording of it."""
    SAY("\n3. A real cable-driven arm: dVRK patient-side manipulator, first three joints, 30 s\n")
    model = load_model(ROOT / "urdf" / "real" / "psm3.yaml")
    layout = {"file": str(data / "dvrk_psm_3dof_gondokaryono" / "psm1_fourier_test_results.csv.gz"), "header": False}
    layout |= {"rate": 200.0, "label": "psm1_fourier_test", "columns": {}}
    for k, quantity in enumerate(("motor_position", "motor_velocity", "motor_torque")):
        layout["columns"] |= {f"{quantity}_{i + 1}": {"from": 3 * k + i + 1} for i in range(3)}
    write_text(folder / "psm3_recording.yaml", yaml.safe_dump(layout, sort_keys=False))
    recording = load_recording(folder / "psm3_recording.yaml", model)

    result = recorded_torques(model, recording)
    save_recording(Recording(recording.time, {"motor_torque": result.tau_m}), folder / "psm3_torque.csv")
    measured = recording.channels["motor_torque"]
    columns = (rms(measured), rms(result.tau_m), rms(measured - result.tau_m))
    rows = [[name, *(column[i] for column in columns)] for i, name in enumerate(model.motors)]
    header = ("motor", "recorded, rms", "model, rms", "difference, rms")
    SAY(table(f"{len(measured)} rows to {folder / 'psm3_torque.csv'} [N m; insertion N]", header, rows))
    SAY(f"{model.n_joints} joints move with {model.n_motors} motors (parallelogram, counterweight): a rectangular E.")
    SAY("The masses in urdf/real/psm3.yaml are guesses; recordings like this one are there to identify them.")


def main() -> None:
    """Run the demonstration."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", default=".demo", type=Path, help="folder for what is written")
    parser.add_argument("--seed", type=int, default=int.from_bytes(os.urandom(2)), help="of the hidden fault")
    args = parser.parse_args()
    folder = args.output
    folder.mkdir(parents=True, exist_ok=True)
    blind_trial(folder, args.seed)
    paper_arm(folder)
    data = data_folder()
    if data is None:
        SAY(
            "\n3. No public recordings found (CDM_PIN_DATA, ./data, ../shared/data): the real arm is left out. "
            "scripts/get_data.py brings them."
        )
    else:
        real_arm(folder, data)
    SAY(f"\nEverything written is in {folder}.")


if __name__ == "__main__":
    main()
