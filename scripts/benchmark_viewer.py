"""How often a browser draws the paper's arm while a computation runs, and what that costs the computation.

Rounds without and with viewer and browser take turns on one process that does what `identify` does: the regressor of a
block of samples, and its triangular factor. Prints blocks a second of both, and frames drawn a second at 500x400.

    python scripts/benchmark_viewer.py [--rounds 5] [--seconds 8]
"""

import argparse
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from cdm_pin.dynamics import inverse_dynamics, joint_torque_regressor
from cdm_pin.model import load_model
from cdm_pin.recording import Recording
from cdm_pin.show import show_recording
from cdm_pin.viewer import Listener, Viewer

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests"))


def record(model, seconds: float = 60.0, rate: float = 200.0) -> Recording:
    """Make a recording with friction that the model lacks, so that cables, discs and arrows all move."""
    t = np.arange(0, seconds, 1 / rate)
    w = 1.1 * (1 + 0.4 * np.arange(model.n_joints))
    phase = w * t[:, None]
    q, v, a = 0.6 * np.sin(phase), 0.6 * w * np.cos(phase), -0.6 * w * w * np.sin(phase)
    torque = model.motor_torque(inverse_dynamics(model, q, v, a) + 0.3 * np.tanh(v / 0.01))
    return Recording(t, {"joint_position": q, "motor_torque": torque}, label="benchmark", pretension=200.0)


def work(model, seconds: float, progress) -> tuple[float, float]:
    """Reduce blocks for that long; give blocks a second, and blocks a second of this process's processor time."""
    rng = np.random.default_rng(0)
    q, v, a = rng.standard_normal((3, 512, model.n_joints))
    end, count, start, used = time.perf_counter() + seconds, 0, time.perf_counter(), time.process_time()
    while time.perf_counter() < end:
        Y = joint_torque_regressor(model, q, v, a).reshape(-1, 10 * model.n_joints)
        np.linalg.qr(Y, mode="r")
        count += 1
        found = [("mx_1", 1.0, 0.1 / count), ("Izz_1", 2.0, 0.2 / count)]
        progress(f"block {count}", (time.perf_counter() - start) / seconds, parameters=found, residual=[0.2, 0.3])
    return count / (time.perf_counter() - start), count / (time.process_time() - used)


def cpu_seconds(root: int) -> float:
    """Processor time that a process and all below it have used so far [s]."""
    below: dict[int, list[int]] = {}
    used: dict[int, float] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            below.setdefault(int(fields[1]), []).append(int(entry.name))
            used[int(entry.name)] = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    todo, total = [root], 0.0
    while todo:
        pid = todo.pop()
        total += used.get(pid, 0.0)
        todo += below.get(pid, [])
    return total


def busy_seconds() -> float:
    """Processor time that everything on this machine has used so far [s]."""
    fields = [int(field) for field in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
    return (sum(fields) - fields[3] - fields[4]) / os.sysconf("SC_CLK_TCK")  # all but idle and waiting


def nobody(step: str, fraction: float, **news) -> None:
    """Listen to nothing."""


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=8.0)
    args = parser.parse_args()
    from browser import Browser

    model = load_model(ROOT / "urdf" / "cdm2.yaml")
    show = show_recording(model, record(model), forces=True)
    work(model, 1.0, nobody)
    alone, watched, frames, cores, others = [], [], [], [], []
    for _ in range(args.rounds):
        busy, used = busy_seconds(), time.process_time()
        alone.append(work(model, args.seconds, nobody))
        beside = busy_seconds() - busy - (time.process_time() - used)
        with Viewer(show) as viewer, Browser(500, 400) as browser:
            browser.visit(viewer.url)
            browser.wait_for("window.cdm && cdm.frames > 5")
            pids = (viewer.process.pid, browser.process.pid)
            before, used, start = browser.evaluate("cdm.frames"), sum(map(cpu_seconds, pids)), time.perf_counter()
            busy, own = busy_seconds(), time.process_time()
            watched.append(work(model, args.seconds, Listener(viewer)))
            elapsed = time.perf_counter() - start
            frames.append((browser.evaluate("cdm.frames") - before) / elapsed)
            cores.append((sum(map(cpu_seconds, pids)) - used) / elapsed)
            by_others = busy_seconds() - busy - (time.process_time() - own) - cores[-1] * elapsed
            others.append((max(beside, 0.0) / args.seconds, max(by_others, 0.0) / elapsed))
    loss = 1 - np.array(watched) / np.array(alone)
    print(f"load of the machine {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    print(f"cores taken by others, alone and watched: {', '.join(f'{a:.1f} {b:.1f}' for a, b in others)}")
    (blocks, own), (blocks_watched, own_watched) = np.median(alone, axis=0), np.median(watched, axis=0)
    print(f"blocks a second: alone {blocks:.0f}, with viewer and browser {blocks_watched:.0f}")
    print(f"blocks a second of its own processor time: alone {own:.0f}, with viewer and browser {own_watched:.0f}")
    wall, inside = 100 * np.median(loss, axis=0)
    print(f"slowed down by {wall:.1f} % (rounds: {', '.join(f'{100 * x:.1f}' for x in loss[:, 0])})")
    print(f"of which by work of its own and shared memory, whatever else runs: {inside:.1f} %")
    print(f"frames drawn a second at 500x400: {np.median(frames):.1f} (worst round {min(frames):.1f})")
    each = 1e3 * np.median(np.array(cores) / frames)
    print(f"processor time of viewer and browser: {np.median(cores):.2f} cores, {each:.1f} ms a frame")


if __name__ == "__main__":
    main()
