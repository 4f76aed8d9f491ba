"""Time and peak memory of base identification, beside figaroh 1.0.2 on the same samples.

Usage: python scripts/benchmark_identification.py [--samples N] [--repeats N] [--environment DIR] [--alone] [-o FILE]

Each run is a process of its own, so that its peak memory is its own. figaroh is installed into an environment of its
own, made on the first run. Both get joint positions, velocities, accelerations and torques with noise, and must find
the same rank and predict the same torques on other samples. Times are the best of some calls in the same process,
after imports and compilation, one thread each. With ``-o`` the tables are written as Markdown too.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

VERSION = "1.0.2"
NOISE = 0.05  # [N m]
STREAM = ("samples", "[s]", "peak [MB]")
COLUMNS = ("rank", "regressor", "identification", "total", "peak", "work")
# KUKA LBR iiwa 14: distances along the arm [m] of its published kinematics, joints alternating about z and y
KUKA = ((0.1575, "z"), (0.2025, "y"), (0.2045, "z"), (0.2155, "y"), (0.1845, "z"), (0.2155, "y"), (0.081, "z"))


def main() -> None:
    """Run both on every robot, print one table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=100_000)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--environment", type=Path, default=Path(tempfile.gettempdir()) / f"figaroh-{VERSION}")
    parser.add_argument("--alone", action="store_true", help="without figaroh")
    parser.add_argument("--long", type=int, default=1_000_000, help="samples of the run that shows constant memory")
    parser.add_argument("-o", "--output", type=Path, help="Markdown file to write")
    parser.add_argument("--run", nargs=3, metavar=("TOOL", "URDF", "OUT"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.run:
        tool, urdf, out = args.run
        results = [RUNS[tool](urdf, args.samples) for _ in range(args.repeats)]
        most = {key: max(result[key] for result in results) for key in ("peak", "work")}
        least = {key: min(result[key] for result in results) for key in ("total", "regressor") if key in results[0]}
        if "regressor" in least:
            least["identification"] = max(least["total"] - least["regressor"], 0.0)
        Path(out).write_text(json.dumps(results[0] | most | least))
        return
    from cdm_pin.console import output, table

    python = None if args.alone else environment(args.environment)
    rows, notes = [], []
    with tempfile.TemporaryDirectory() as folder:
        for name, urdf in robots(Path(folder)).items():
            ours = run(sys.executable, "cdm_pin", urdf, args.samples, folder, args.repeats)
            rows.append([name, "cdm_pin", *(ours[key] for key in COLUMNS)])
            if python is not None:
                theirs = run(python, "figaroh", urdf, args.samples, folder, args.repeats)
                rows.append([name, "figaroh", *(theirs[key] for key in COLUMNS)])
                notes.append(f"{name}: {compared(ours, theirs)}")
        lengths = (args.long // 10, args.long)
        long = [run(sys.executable, "stream", urdf, n, folder) for n in lengths]
    header = ("robot", "tool", "rank", "regressor [s]", "base id. [s]", "in all [s]", "peak [MB]", "its work [MB]")
    title = f"{args.samples} samples, figaroh {VERSION}"
    output().print(table(title, header, rows), *notes, sep="\n")
    streamed = [[n, r["total"], r["peak"]] for n, r in zip(lengths, long, strict=True)]
    output().print(table("7 joints, samples folded in as they are drawn", STREAM, streamed))
    if args.output is not None:
        args.output.write_text(document(title, header, rows, notes, streamed), encoding="utf-8")


def document(title: str, header: Sequence[str], rows: list, notes: Sequence[str], streamed: list) -> str:
    """Write what was measured as Markdown."""
    lines = [
        "# Base identification: time and memory",
        "",
        f"Written by `scripts/benchmark_identification.py -o` on {processor()}, one thread. Each tool runs in a "
        "process of its own on the same joint positions, velocities, accelerations and noisy torques; *base id.* is "
        "all but the regressor: base parameters, reduction and fit. *Peak* is the resident memory of the whole "
        "process, imports and samples included; *its work* is what the identification adds to that.",
        "",
        f"## {title}",
        "",
        *markdown(header, rows),
        "",
        *(f"- {note}." for note in notes),
        "",
        "## Memory does not grow: 7 joints, samples folded in as they are drawn",
        "",
        *markdown(STREAM, streamed),
    ]
    return "\n".join(lines) + "\n"


def markdown(header: Sequence[str], rows: list) -> list[str]:
    """Give the lines of a table."""
    cells = [[f"{x:.3g}" if isinstance(x, float) else str(x) for x in row] for row in rows]
    return [f"| {' | '.join(row)} |" for row in ([*header], ["---"] * len(header), *cells)]


def processor() -> str:
    """Name the processor."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "this machine")


def compared(ours: dict, theirs: dict) -> str:
    """Say how the two compare; refuse to compare what is not the same result."""
    difference = np.abs(np.array(ours["predicted"]) - np.array(theirs["predicted"])).max()
    assert ours["rank"] == theirs["rank"] and difference < 1e-6, (ours["rank"], theirs["rank"], difference)
    times, bare = theirs["total"] / ours["total"], theirs["identification"] / max(ours["identification"], 1e-3)
    leaner, work = theirs["peak"] / ours["peak"], theirs["work"] / max(ours["work"], 1.0)
    return (
        f"same rank, predictions equal to {difference:.0e} N m; {times:.1f} times faster in all, {bare:.1f} times in "
        f"base identification; {leaner:.1f} times less memory, {work:.0f} times beside imports and samples"
    )


def run(python: str, tool: str, urdf: str, samples: int, folder: str, repeats: int = 1) -> dict:
    """Run one tool in a process of its own."""
    out = Path(folder) / "result.json"
    sizes = ["--samples", str(samples), "--repeats", str(repeats)]
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    command = [python, __file__, *sizes, "--run", tool, urdf, str(out)]
    subprocess.run(command, check=True, env=os.environ | threads)
    return json.loads(out.read_text())


def environment(folder: Path) -> str:
    """Give the interpreter of an environment that has figaroh; make it on the first call."""
    python = folder / "bin" / "python"
    if not (folder / "ready").exists():
        print(f"installing figaroh {VERSION} into {folder}", file=sys.stderr)
        venv.create(folder, with_pip=True, clear=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", f"figaroh=={VERSION}"], check=True)
        (folder / "ready").touch()
    return str(python)


def robots(folder: Path) -> dict[str, str]:
    """Give the URDFs: two joints, UR10, KUKA."""
    from cdm_pin.robots import robot_urdf

    kuka = folder / "kuka.urdf"
    kuka.write_text(kuka_urdf())
    return {
        "2 joints": str(robot_urdf("double_pendulum_simple")),
        "UR10": str(robot_urdf("ur10_robot")),
        "KUKA": str(kuka),
    }


def kuka_urdf() -> str:
    """Write a 7-joint arm of the iiwa's kinematics, with round numbers for its masses."""
    lines = ['<robot name="kuka"><link name="link_0"/>']
    for i, (length, axis) in enumerate(KUKA, 1):
        mass = 5.0 - 0.5 * i
        across, about = 0.02 * mass, 0.01 * mass
        lines.append(
            f'<link name="link_{i}"><inertial><origin xyz="0.01 0.02 {length / 2}"/><mass value="{mass}"/>'
            f'<inertia ixx="{across}" iyy="{across}" izz="{about}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="joint_{i}" type="revolute"><parent link="link_{i - 1}"/><child link="link_{i}"/>'
            f'<origin xyz="0 0 {length}"/><axis xyz="0 {int(axis == "y")} {int(axis == "z")}"/>'
            '<limit lower="-2.9" upper="2.9" effort="300" velocity="2"/></joint>'
        )
    return "".join([*lines, "</robot>"])


def samples_of(model, n: int, seed: int, order=slice(None)):
    """Draw states and torques with noise; joints in Pinocchio's order or as told."""
    import pinocchio as pin

    rng = np.random.default_rng(seed)
    q, v, a = rng.uniform(-1, 1, (3, n, model.nv)) * np.array([2.5, 2.0, 8.0])[:, None, None]
    data = model.createData()
    tau = np.array([pin.rnea(model, data, *state) for state in zip(q, v, a, strict=True)])
    tau += NOISE * rng.normal(size=tau.shape)
    return tuple(x[:, order] for x in (q, v, a, tau))


def memory(field: str) -> float:
    """Read the resident memory of this process (``VmRSS``) or its peak (``VmHWM``) [MB]."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(field)) / 1024


def measured(work) -> dict:
    """Do the work; add the peak memory while it is done, and how much of it is the work's own."""
    Path("/proc/self/clear_refs").write_text("5")  # the peak so far is forgotten
    before = memory("VmRSS")
    result = work()
    return {**result, "peak": memory("VmHWM"), "work": memory("VmHWM") - before}


def run_figaroh(urdf: str, n: int) -> dict:
    """Build its regressor, drop empty columns, decompose, solve."""
    from types import SimpleNamespace

    import pinocchio as pin
    from figaroh.identification.parameter import get_standard_parameters
    from figaroh.tools.qrdecomposition import QRDecomposer
    from figaroh.tools.regressor import build_regressor_basic, build_regressor_reduced, get_index_eliminate

    model = pin.buildModelFromUrdf(urdf)
    robot = SimpleNamespace(model=model, data=model.createData())
    config = {"act_idxv": list(range(model.nv)), "is_joint_torques": True}
    test = samples_of(model, 50, 1)

    def identify(q, v, a, tau):
        start = time.perf_counter()
        W = build_regressor_basic(robot, q, v, a, config)
        middle = time.perf_counter()
        params = get_standard_parameters(model, config)
        empty, kept = get_index_eliminate(W, params)
        result = QRDecomposer().decompose(build_regressor_reduced(W, empty), kept, tau.T.ravel(), params)
        end = time.perf_counter()
        W_test = build_regressor_reduced(build_regressor_basic(robot, *test[:3], config), empty)
        predicted = W_test[:, result.base_indices] @ result.phi_b
        return {
            "rank": result.rank,
            "regressor": middle - start,
            "identification": end - middle,
            "total": end - start,
            "predicted": predicted.reshape(model.nv, -1).T.tolist(),
        }

    identify(*samples_of(model, 500, 2))
    data = samples_of(model, n, 0)
    return measured(lambda: identify(*data))


def run_cdm_pin(urdf: str, n: int) -> dict:
    """Find base parameters, fold the samples into a triangle, solve with the noise covariance over motors."""
    from cdm_pin.estimators import ordinary
    from cdm_pin.regressor import blocks, motor_regressor
    from cdm_pin.streaming import identify_samples

    model = model_of(urdf)
    order = model.velocity_index
    test = samples_of(model.pin_model, 50, 1, order)

    def identify(*data):
        start = time.perf_counter()
        base, fit = identify_samples(model, [data], estimator=ordinary)
        end = time.perf_counter()
        predicted = np.empty_like(test[0])
        predicted[:, order] = base.regressor(model, *test[:3]) @ fit.values
        return {"rank": base.rank, "total": end - start, "predicted": predicted.tolist()}

    identify(*samples_of(model.pin_model, 500, 2, order))
    data = samples_of(model.pin_model, n, 0, order)
    result = measured(lambda: identify(*data))
    start = time.perf_counter()
    for part in blocks(n):
        motor_regressor(model, *(x[part] for x in data[:3]))
    regressor = time.perf_counter() - start
    return {**result, "regressor": regressor, "identification": result["total"] - regressor}


def run_stream(urdf: str, n: int) -> dict:
    """Fold in samples as they are drawn."""
    from cdm_pin.dynamics import inverse_dynamics
    from cdm_pin.streaming import identify_samples

    model = model_of(urdf)
    rng = np.random.default_rng(0)

    def parts():
        for _ in range(n // 10_000):
            q, v, a = rng.uniform(-2, 2, (3, 10_000, model.n_joints))
            yield q, v, a, inverse_dynamics(model, q, v, a)

    def work():
        start = time.perf_counter()
        identify_samples(model, parts())
        return {"total": time.perf_counter() - start}

    return measured(work)


def model_of(urdf: str):
    """Load a robot whose joints are its motors."""
    from cdm_pin.manipulator import parse_manipulator
    from cdm_pin.model import build_model

    return build_model(parse_manipulator({"urdf": urdf}))


RUNS = {"cdm_pin": run_cdm_pin, "figaroh": run_figaroh, "stream": run_stream}

if __name__ == "__main__":
    main()
