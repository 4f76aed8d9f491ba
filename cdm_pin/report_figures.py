"""The figures of a report: each takes plain arrays and gives SVG text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import welch

from . import svg
from .report_evidence import LawCurve, RunEvidence, SimulatedMotion
from .svg import BLACK, BLUE, GREY, VERMILLION, Chart
from .units import either

TIME_BINS, STATE_BINS = 120, 12


def residuals(run: RunEvidence) -> tuple[np.ndarray, np.ndarray]:
    """Give measured minus rigid and measured minus completed, shape (n, n_motors); NaN where not judged."""
    keep = np.ones(len(run.time), bool) if run.valid is None else np.asarray(run.valid, bool)
    pair = (run.measured - run.rigid, run.measured - run.augmented)
    return tuple(np.where(keep[:, None], np.asarray(r, float), np.nan) for r in pair)  # pyright: ignore


@dataclass(frozen=True)
class Rows:
    """The rows of a heat map: where a residual may sit, each in units of its own noise.

    Attributes
    ----------
    names : tuple of str
    from_motors : ndarray, shape (n_rows, n_motors)
        Residuals of the motors -> rows.
    label : str
        Of the colour scale.
    """

    names: tuple[str, ...]
    from_motors: np.ndarray
    label: str


def rows(joint_from_motor: np.ndarray, floor: np.ndarray | None, units: Sequence[str]) -> Rows:
    """Choose the rows: the motors, and the joints too unless every motor turns one joint.

    Torques go over by tau = pinv(E') tau_m, positions by q = E q_m.
    """
    E = joint_from_motor
    n_joints, n_motors = E.shape
    names = tuple(f"joint {i + 1}" for i in range(n_joints))
    maps = E if units[0] in ("rad", "m") else np.linalg.pinv(E.T)
    if n_joints != n_motors or np.abs(E - np.diag(np.diag(E))).max() > 1e-9:
        names += tuple(f"motor {i + 1}" for i in range(n_motors))
        maps = np.vstack([maps, np.eye(n_motors)])
    if floor is None or not np.all(np.asarray(floor) > 0):
        return Rows(names, maps, f"rms error [{either(units)}]")
    return Rows(names, maps / np.linalg.norm(maps * floor, axis=1)[:, None], "rms error / noise floor")


def time_maps(run: RunEvidence, rows: Rows) -> list[tuple[str, str]]:
    """Draw the size of the residual at each joint and motor over time, before and after, on one scale.

    Returns
    -------
    list of (title, svg)
    """
    maps = [_binned_rms(r @ rows.from_motors.T, TIME_BINS) for r in residuals(run)]
    top = _largest(maps[0])
    out = []
    for title, values in zip(("before", "after"), maps, strict=True):
        chart = Chart((run.time[0], run.time[-1]), (0, len(values)), "time [s]", height=56 + 20 * len(values))
        chart.image(values, (0.0, top), svg.SEQUENTIAL)
        picture = chart.render(f"error at each joint and motor over time, {title}", y_names=rows.names)
        out.append((f"{run.label}: {title}", picture + svg.colour_bar((0.0, top), svg.SEQUENTIAL, rows.label)))
    return out


def state_maps(runs: Sequence[RunEvidence], rows: Rows) -> list[tuple[str, str]]:
    """Draw the mean residual at each joint and motor against the position and the velocity of each joint.

    Returns
    -------
    list of (title, svg)
        One per joint and quantity, all on one scale, and the scale.
    """
    known = [(run.q, run.v, residuals(run)[0]) for run in runs if run.q is not None and run.v is not None]
    if not known:
        return []
    q, v, before = (np.vstack(parts) for parts in zip(*known, strict=True))
    before = before @ rows.from_motors.T
    panels = []
    for joint in range(q.shape[1]):
        unit = runs[0].joint_unit(joint)
        for name, x in ((f"position [{unit}]", q), (f"velocity [{unit}/s]", v)):
            panels.append((f"joint {joint + 1} {name}", *_binned_mean(x[:, joint], before)))
    top = max(_largest(np.abs(mean)) for _, _, mean in panels)
    out = []
    for name, edges, mean in panels:
        chart = Chart(edges, (0, len(mean)), name, width=300, height=56 + 18 * len(mean))
        chart.image(mean, (-top, top), svg.DIVERGING)
        out.append((name, chart.render(f"mean error at each joint and motor against {name}", y_names=rows.names)))
    return [*out, ("scale", svg.colour_bar((-top, top), svg.DIVERGING, rows.label.replace("rms", "mean")))]


def law(curve: LawCurve, title: str) -> str:
    """Draw a fitted law (averaged over neighbours unless it is a loop) over its data.

    The limits hold all of the law and 99 % of the data.
    """
    x, y, fit = (np.asarray(a, float) for a in (curve.x, curve.y_points, curve.y_fit))
    finite = y[np.isfinite(y)]
    spread = np.percentile(finite, [0.5, 99.5]) if len(finite) else np.zeros(1)
    chart = Chart(svg.limits(x), svg.limits(fit, spread), curve.x_label, curve.y_label)
    chart.points(x, y, GREY, opacity=0.35)
    if curve.loop:
        part = np.linspace(0, len(x) - 1, min(len(x), 4000)).astype(int)
        chart.line(x[part], fit[part], BLUE, width=1.2)
    else:
        order = np.array_split(np.argsort(x, kind="stable"), max(min(len(x), 150), 1))
        line = np.array([(x[part].mean(), fit[part].mean()) for part in order if len(part)]).reshape(-1, 2)
        chart.line(line[:, 0], line[:, 1], BLUE, width=2.2)
    return chart.render(title)


def worst_stretch(run: RunEvidence, motor: int, floor: float | None, seconds: float = 10.0) -> list[tuple[str, str]]:
    """Draw measured, rigid and completed torque, and both errors, over the stretch that shows the most.

    Returns
    -------
    list of (title, svg)
    """
    rigid, augmented = (r[:, motor] for r in residuals(run))
    start = _largest_window(run.time, np.nan_to_num(rigid), seconds)
    part = (run.time >= start) & (run.time <= start + seconds)
    t = run.time[part]
    unit = f"motor {motor + 1} [{run.unit(motor)}]"
    torque = Chart((t[0], t[-1]), svg.limits(run.measured[part, motor], run.rigid[part, motor]), "time [s]", unit)
    torque.line(t, run.measured[part, motor], BLACK, width=1.2)
    torque.line(t, run.rigid[part, motor], VERMILLION, dash="6 3")
    torque.line(t, run.augmented[part, motor], BLUE)
    error = Chart((t[0], t[-1]), svg.limits(rigid[part], augmented[part]), "time [s]", f"error of {unit}")
    if floor:
        error.band(-2 * floor, 2 * floor)
    error.line(t, rigid[part], VERMILLION, dash="6 3")
    error.line(t, augmented[part], BLUE)
    return [
        ("torque", torque.render("measured, rigid and completed torque over time")),
        ("error", error.render("error of the rigid and of the completed model over time, with the noise floor")),
    ]


def spectrum(run: RunEvidence, motor: int, floor: float | None) -> str:
    """Draw the amplitude spectra of both errors and of white noise at the floor; nothing if the run is short."""
    keep = np.ones(len(run.time), bool) if run.valid is None else np.asarray(run.valid, bool)
    if keep.sum() < 256:
        return ""
    rate = 1.0 / float(np.median(np.diff(run.time)))
    size = int(min(2048, keep.sum() // 2))
    pair = [welch(r[keep, motor], rate, nperseg=size) for r in residuals(run)]
    f = pair[0][0][1:]
    rigid, augmented = (np.sqrt(p[1][1:]) for p in pair)
    low = max(min(float(rigid.min()), float(augmented.min())), float(rigid.max()) * 1e-5, 1e-12)
    chart = Chart(
        (f[0], f[-1]), (low, float(max(rigid.max(), augmented.max())) * 1.5 + 1e-12),
        "frequency [Hz]", f"error of motor {motor + 1} [{run.unit(motor)}/√Hz]", log=True,
    )  # fmt: skip
    if floor:
        level = floor / np.sqrt(rate / 2)
        chart.line(f[[0, -1]], np.array([level, level]), GREY, dash="2 3")
    chart.line(f, np.maximum(rigid, low), VERMILLION, dash="6 3")
    chart.line(f, np.maximum(augmented, low), BLUE)
    return chart.render("spectra of the errors of the rigid and of the completed model")


def simulated_motion(motion: SimulatedMotion) -> list[tuple[str, str]]:
    """Draw recorded and simulated positions of each joint.

    Returns
    -------
    list of (title, svg)
    """
    out = []
    for joint in range(motion.recorded.shape[1]):
        arrays = [np.asarray(a, float)[:, joint] for a in (motion.recorded, motion.rigid, motion.augmented)]
        unit = motion.units[joint % len(motion.units)]
        span = svg.limits(arrays[0], arrays[2], np.clip(arrays[1], *svg.limits(arrays[0], margin=1.0)))
        chart = Chart((motion.time[0], motion.time[-1]), span, "time [s]", f"joint {joint + 1} [{unit}]")
        chart.line(motion.time, arrays[0], BLACK, width=1.2)
        chart.line(motion.time, arrays[1], VERMILLION, dash="6 3")
        chart.line(motion.time, arrays[2], BLUE)
        out.append((f"joint {joint + 1} {motion.label}".strip(), chart.render("recorded and simulated positions")))
    return out


def error_bars(rows: list[tuple[str, float, float, float | None]], unit: str) -> str:
    """Draw errors before and after, and the floor, as bars: rows of (name, rigid, completed, floor)."""
    top = max((max(r, a, f or 0.0) for _, r, a, f in rows), default=0.0) or 1.0
    body, left, wide = "", 92, 250
    for k, (name, rigid, augmented, floor) in enumerate(rows):
        y = 8 + 44 * k
        body += svg.text(left - 6, y + 20, name, anchor="end")
        for value, colour, dy in ((rigid, VERMILLION, 2), (augmented, BLUE, 18)):
            width = max(wide * value / top, 1.0)
            body += f'<rect x="{left}" y="{y + dy}" width="{width:.1f}" height="13" fill="{colour}"/>'
            body += svg.text(left + width + 5, y + dy + 11, f"{value:.3g}")
        if floor:
            x = left + wide * floor / top
            body += f'<path d="M{x:.1f} {y}v34" stroke="{BLACK}" stroke-width="1.5" stroke-dasharray="3 2"/>'
    return svg.svg(440, 44 * len(rows) + 12, body, f"errors before and after, with the noise floor, in {unit}")


def _largest(values: np.ndarray) -> float:
    return max(float(np.max(values, where=np.isfinite(values), initial=0.0)), 1e-12)


def _binned_rms(r: np.ndarray, count: int) -> np.ndarray:
    """Root mean square per motor (row) and part of the run (column)."""
    parts = np.array_split(r, min(count, len(r)))
    count_in = np.array([np.isfinite(p).sum(0) for p in parts])
    total = np.array([np.nansum(p**2, 0) for p in parts])
    return np.sqrt(np.where(count_in > 0, total / np.maximum(count_in, 1), np.nan)).T


def _binned_mean(x: np.ndarray, r: np.ndarray) -> tuple[tuple[float, float], np.ndarray]:
    """Mean of `r` per motor (row) in equal bins of `x` (columns); NaN where fewer than 5 samples fell."""
    good = np.isfinite(x) & np.isfinite(r).all(1)
    if not good.any():
        return (0.0, 1.0), np.full((r.shape[1], STATE_BINS), np.nan)
    low, high = np.percentile(x[good], [0.5, 99.5])
    high = high if high > low else low + 1.0
    bins = ((x - low) / (high - low) * STATE_BINS).clip(0, STATE_BINS - 1)
    bins = np.where(good, bins, 0).astype(int)[good]
    count = np.bincount(bins, minlength=STATE_BINS)
    total = np.array([np.bincount(bins, r[good, i], STATE_BINS) for i in range(r.shape[1])])
    return (float(low), float(high)), np.where(count >= 5, total / np.maximum(count, 1), np.nan)


def _largest_window(time: np.ndarray, r: np.ndarray, seconds: float) -> float:
    """Start of the stretch of given length whose error is largest."""
    if time[-1] - time[0] <= seconds:
        return float(time[0])
    total = np.concatenate([[0.0], np.cumsum(r**2)])
    end = np.searchsorted(time, time + seconds)
    starts = np.flatnonzero(time <= time[-1] - seconds)
    return float(time[starts[np.argmax(total[end[starts]] - total[starts])]])
