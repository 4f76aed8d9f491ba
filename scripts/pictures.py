"""Take the pictures of the README: the live scene and a report, as a browser shows them.

An arm of three links has 0.31 N m of dry friction at joint 2 that its file lacks; two recordings are diagnosed, a third
one judges.

    python scripts/pictures.py [-o docs]
"""

import argparse
import io
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image

from cdm_pin.console import plain
from cdm_pin.diagnose import diagnose
from cdm_pin.dynamics import inverse_dynamics
from cdm_pin.gather import gather
from cdm_pin.recording import Recording
from cdm_pin.report import write_report
from cdm_pin.show import show_recording
from cdm_pin.viewer import Viewer, link

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests"))

COULOMB, NOISE = 0.31, 0.02  # N m


def record(model, seed: int, seconds: float = 40.0, rate: float = 200.0) -> Recording:
    """Make a recording along a random Fourier series."""
    rng = np.random.default_rng(seed)
    t, n = np.arange(0, seconds, 1 / rate), model.n_joints
    q, v, a = np.zeros((3, len(t), n))
    for k in range(1, 6):
        w = 2 * np.pi * 0.08 * k * (1 + 0.15 * np.arange(n))
        phase, size = rng.uniform(0, 2 * np.pi, n), rng.uniform(0.14, 0.35, n) / np.sqrt(k)
        q += size * np.sin(w * t[:, None] + phase)
        v += size * w * np.cos(w * t[:, None] + phase)
        a -= size * w * w * np.sin(w * t[:, None] + phase)
    tau = inverse_dynamics(model, q, v, a)
    tau[:, 1] += COULOMB * np.tanh(v[:, 1] / 0.003)
    noisy = model.motor_torque(tau) + NOISE * rng.standard_normal((len(t), model.n_motors))
    return Recording(t, {"joint_position": q, "motor_torque": noisy}, label=f"run{seed}", pretension=250.0)


def save(png: bytes, path: Path, size: tuple[int, int], top: int | None = None) -> None:
    """Shrink a screenshot taken at twice the size, keep its upper part, reduce its colours, and write it."""
    image = Image.open(io.BytesIO(png)).convert("RGB").resize(size, Image.Resampling.LANCZOS)
    image = image.crop((0, 0, size[0], top or size[1]))
    image.quantize(256).save(path, optimize=True)
    print(f"{path}: {path.stat().st_size / 1024:.0f} kB")


def main() -> None:
    """Take the pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs")
    folder = parser.parse_args().output
    import view_cases
    from browser import Browser

    model = view_cases.arm(3, "arm")
    runs = [record(model, seed) for seed in (1, 2, 3)]
    result = diagnose(model, runs[:2], runs[2:])
    content = plain(result.content)
    with tempfile.TemporaryDirectory() as temporary, Browser(840, 1150, scale=2) as browser:
        report = Path(temporary) / "report.html"
        write_report(report, content, gather(result), result.model)
        browser.visit(report.as_uri())
        time.sleep(1.5)
        save(browser.screenshot(), folder / "report.png", (840, 1150))
    with Viewer(show_recording(model, runs[2], news=link(content))) as viewer, Browser(900, 520, scale=2) as browser:
        browser.visit(viewer.url)
        browser.wait_for("window.cdm && cdm.frames > 2", 60)
        browser.evaluate("send({seek: 12.4, playing: false})")
        browser.wait_for("!playing && Math.abs(byId('seek').value - 12.4) < 0.1", 60)
        time.sleep(2.0)
        save(browser.screenshot(), folder / "scene.png", (900, 520))


if __name__ == "__main__":
    main()
