"""One trial of the proof: draw, publish, diagnose what was published, score; and the baselines on the same files."""

from __future__ import annotations

import functools
import hashlib
import json
import signal
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import proof_baselines as baselines
import yaml
from blind_trial import published
from proof_studies import Task

from cdm_pin.console import plain
from cdm_pin.plant.catalogue import draw_fault
from cdm_pin.plant.draw import Trial, draw
from cdm_pin.plant.oracle import SURE, Oracle
from cdm_pin.plant.run import altered
from cdm_pin.plant.sensing import drift_basis
from cdm_pin.scoring import Score, describe, score

FIELDS = (
    "study", "index", "seed", "code", "links", "positions", "bits", "noise", "motion", "plant", "effects", "places",
    "visibility", "kinematic", "fraction", "truth", "verdict", "findings", "meetings", "first", "all", "false",
    "alike", "unexplained", "over_floor", "over_noise", "share", "parameters", "sensitivity", "residual", "mass_error",
    "cpu", "wall", "every_friction", "stepwise", "sparse", "failure",
)  # fmt: skip
_SIMPLE = {  # effects without shape, and the parameter whose smallest visible value a diagnosis prints
    "viscous_friction": "viscous",
    "coulomb_friction": "coulomb",
    "quadratic_drag": "coefficient",
    "torque_dependent_friction": "coefficient",
    "torque_offset": "offset",
    "base_tilt": "angle",
    "encoder_offset": "offset",
    "time_delay": "delay",
    "transmission_ratio_error": "relative_error",
}
_SENSITIVITIES = 3  # of those that a clean trial prints, held against the oracle


class Timeout(Exception):
    """The diagnosis took too long."""


def run(task: Task) -> dict[str, Any]:
    """Run a trial; give its row.

    Whatever the diagnosis raises, and a time above ``task.options["timeout"]`` [s], is a row as well: it counts as a
    failure.
    """
    trial = draw(task.seed, **task.settings)
    oracle = Oracle(trial.scene)
    row = _concealed(task, trial)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        trial.write(folder)["truth"].unlink()
        start, cpu = time.perf_counter(), time.process_time()
        try:
            with _limited(task.options.get("timeout", 0.0)):
                content = _diagnose(folder)
        except Exception as exc:
            content = None
            row["failure"] = f"{type(exc).__name__}: {str(exc).splitlines()[0] if str(exc) else ''}"[:120]
        row |= {"cpu": _short(time.process_time() - cpu), "wall": _short(time.perf_counter() - start)}
        if content is not None:
            row |= _told(trial, oracle, content)
        if task.options.get("baselines", True):
            row |= _baselines(folder, trial, oracle, task.options.get("pysindy"))
    return row


def _diagnose(folder: Path) -> dict[str, Any]:
    from cdm_pin.diagnose import diagnose
    from cdm_pin.model import load_model
    from cdm_pin.recording import load_recording

    model = load_model(folder / "manipulator.yaml")
    runs, holdout = ([load_recording(path, model) for path in published(folder, kind)] for kind in ("run", "holdout"))
    return plain(diagnose(model, runs, holdout).content)


@contextmanager
def _limited(seconds: float):
    def stop(number, frame):
        raise Timeout(f"more than {seconds:g} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def blank(task: Task, failure: str) -> dict[str, Any]:
    """Give the row of a trial of which nothing came back."""
    row = dict.fromkeys(FIELDS, "")
    return row | {"study": task.study, "index": task.index, "seed": task.seed, "code": code(), "failure": failure}


@functools.cache
def code() -> str:
    """Fingerprint of the package's sources: which diagnosis made a row."""
    folder = Path(__file__).resolve().parent.parent / "cdm_pin"
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:8]


def _short(x: float | None) -> str:
    return "" if x is None or not np.isfinite(x) else f"{x:.3g}"


def _concealed(task: Task, trial: Trial) -> dict[str, Any]:
    truth = trial.truth
    effects, sensors = truth["effects"], truth["sensors"]
    text = json.dumps(truth, sort_keys=True)
    return blank(task, "") | {
        "links": truth["n_links"],
        "positions": sensors["positions"],
        "bits": sensors["bits"],
        "noise": "coloured" if truth["noise"]["correlation"] else "white",
        "motion": truth["motion"],
        "plant": truth["plant"],
        "effects": ";".join(e["effect"] for e in effects),
        "places": ";".join(describe(e["location"]) for e in effects),
        "visibility": ";".join(_short(e["visibility"]) for e in effects),
        "kinematic": ";".join(_short(e["kinematic_visibility"]) for e in effects),
        "fraction": ";".join(_short(e["visible_fraction"]) for e in effects),
        "truth": hashlib.sha256(text.encode()).hexdigest()[:8],
    }


def _told(trial: Trial, oracle: Oracle, content: Mapping[str, Any]) -> dict[str, Any]:
    result = score(trial.truth, content, oracle.likeness)
    over_noise, share = _holdout(trial, content)
    return {
        "verdict": content["verdict"],
        "findings": ";".join(f"{f['effect']} {describe(f['location'])}" for f in content["findings"]),
        "meetings": ";".join(result.meetings),
        "first": int(result.first_right),
        "all": int(result.all_right),
        "false": len(result.false_findings),
        "alike": _alike(oracle, result, content),
        "unexplained": "" if result.unexplained_right is None else int(result.unexplained_right),
        "over_floor": _short(result.holdout_over_floor),
        "over_noise": _short(over_noise),
        "share": _short(share),
        "parameters": _parameters(trial, oracle, result),
        "sensitivity": "" if trial.truth["effects"] else _sensitivity(trial, oracle, content),
    }


def _alike(oracle: Oracle, result: Score, content: Mapping[str, Any]) -> str:
    """Tell how like the first effect that was missed the strongest finding is, class or not: canonical correlation."""
    missed = [k for k, meeting in enumerate(result.meetings) if meeting == "missed"]
    if not (missed and content["findings"]):
        return ""
    return _short(oracle.likeness(missed[0], content["findings"][0]))


def _holdout(trial: Trial, content: Mapping[str, Any]) -> tuple[float | None, float | None]:
    """Torque error on the unseen run over the noise that the generator put there; share of the possible reduction."""
    fit = (content.get("fit") or {}).get("holdout")
    if not fit:
        return None, None
    rigid, error, floor = (np.mean(np.square(fit[name])) for name in ("rmse_rigid", "rmse_augmented", "noise_floor"))
    noise = np.mean(_noise_power(trial, content["data"]["band"][1]))
    possible = rigid - floor
    share = float((rigid - error) / possible) if possible > 0.1 * floor else None
    return float(np.sqrt(error / noise)), share


def _noise_power(trial: Trial, cutoff: float) -> np.ndarray:
    """Give the expected square (n,) [N^2 m^2] of the generator's torque noise below `cutoff` [Hz]."""
    noise, rate = trial.scene.noise, trial.scene.sensors.rate
    r, omega = noise.correlation, np.linspace(0.0, 2.0 * np.pi * min(cutoff / rate, 0.5), 500)
    spectrum = (1.0 - r * r) / (1.0 - 2.0 * r * np.cos(omega) + r * r)
    slow = drift_basis(trial.scene.t)
    drift = noise.drift**2 * float(np.mean(np.sum(slow**2, axis=1))) / slow.shape[1]
    return noise.std**2 * float(np.trapezoid(spectrum, omega)) / np.pi + drift


def _parameters(trial: Trial, oracle: Oracle, result: Score) -> str:
    """List name=true~value~std~bound of exactly met effects."""
    if not result.parameters:
        return ""
    bounds = {}
    for effect, bound in zip(trial.truth["effects"], oracle.bounds(), strict=True):
        bounds.setdefault(effect["effect"], bound)
    return ";".join(
        f"{p.name}={p.true:.4g}~{p.value:.4g}~{p.std:.3g}~{bounds[p.effect].get(p.name, np.nan):.3g}"
        for p in result.parameters
    )


def _sensitivity(trial: Trial, oracle: Oracle, content: Mapping[str, Any]) -> str:
    """Smallest amplitude printed over the oracle's, for a few of the effects and places listed."""
    rng = np.random.default_rng(trial.truth["seed"])
    scene, ratios = trial.scene, []
    rows = [
        row
        for row in content["sensitivity"]
        if row["effect"] in _SIMPLE and row["amplitude"] and "weights" not in row["location"]
    ]
    for k in rng.permutation(len(rows))[:_SENSITIVITIES]:
        row, n = rows[k], scene.arm.length.size
        location = dict(row["location"])
        if row["effect"] == "transmission_ratio_error":
            location = {"kind": "cable", "index": location["index"], "joint": location.get("joint", location["index"])}
        fault = draw_fault(row["effect"], rng, n, scene.scale)
        fault = replace(fault, location=location, parameters={_SIMPLE[row["effect"]]: row["amplitude"]}, width=0.02)
        ratios.append(float(np.linalg.norm(oracle.signature(fault, []))) / SURE)
    return ";".join(_short(r) for r in ratios)


def _baselines(folder: Path, trial: Trial, oracle: Oracle, pysindy: str | None) -> dict[str, Any]:
    content = yaml.safe_load((folder / "manipulator.yaml").read_text(encoding="utf-8"))
    parts = []
    for path in sorted(folder.glob("run_*.csv")):
        with open(path, encoding="utf-8") as file:
            names = file.readline().strip().split(",")
            parts.append(baselines.prepare(content, dict(zip(names, np.loadtxt(file, delimiter=",").T, strict=True))))
    data = baselines.joined(parts)
    fit = baselines.rigid_fit(data, altered(trial.scene.arm, trial.scene.faults)[0])
    row = {"residual": _short(fit["residual"]), "mass_error": _short(fit["error"])}
    methods: dict[str, Callable[[baselines.Plain], list[dict[str, Any]]]] = {
        "every_friction": baselines.every_friction,
        "stepwise": baselines.stepwise,
    }
    if pysindy:
        methods["sparse"] = _sindy(pysindy)
    for name, method in methods.items():
        row[name] = _judged(trial, method(data))
    return row


@functools.cache
def _sindy(python: str) -> baselines.Sindy:
    return baselines.Sindy(python)


def _judged(trial: Trial, findings: Sequence[Mapping[str, Any]]) -> str:
    """Give first right, all right, number of false findings."""
    result = score(trial.truth, baselines.as_diagnosis(list(findings)))
    return f"{int(result.first_right)}/{int(result.all_right)}/{len(result.false_findings)}"
