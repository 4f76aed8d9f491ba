"""Figures of docs/paper.md, small and the same bytes for the same data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib import pyplot as plt

from cdm_pin.excitation import Design
from cdm_pin.files import whole_file
from cdm_pin.fourier import FourierSeries
from cdm_pin.plant.simulate import Run

plt.rcParams.update({"font.size": 8, "lines.linewidth": 1.0, "axes.grid": True, "grid.alpha": 0.3})


def _save(figure, path: Path) -> None:
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=90, metadata={"Software": None})
    plt.close(figure)


def control(alone: Run, fed: Run, path: Path) -> None:
    """Draw positions, errors and control inputs of two cases (Figures 8, 9)."""
    figure, axes = plt.subplots(3, 2, figsize=(8, 6.5), sharex=True, layout="constrained")
    for i in range(2):
        axes[0, i].plot(alone.time, alone.q_desired[:, i], "k--", label="desired")
        axes[0, i].plot(alone.time, alone.q[:, i], label="PID")
        axes[0, i].plot(fed.time, fed.q[:, i], label="PID with model")
        axes[0, i].set(title=f"joint {i + 1}", ylabel="position [rad]")
        axes[1, i].semilogy(alone.time, 1e-9 + np.abs(alone.q - alone.q_desired)[:, i], label="PID")
        axes[1, i].semilogy(fed.time, 1e-9 + np.abs(fed.q - fed.q_desired)[:, i], label="PID with model")
        axes[1, i].set(ylabel="error [rad]", ylim=(1e-7, 1e-1))
        axes[2, i].plot(alone.time, alone.tau_m[:, i], label="PID alone")
        axes[2, i].plot(fed.time, (fed.tau_m - fed.tau_pid)[:, i], "--", label="model")
        axes[2, i].plot(fed.time, fed.tau_pid[:, i], label="PID with model: PID")
        axes[2, i].set(xlabel="time [s]", ylabel=f"motor {i + 1} [N m]")
    for row in axes:
        row[0].legend(fontsize=7)
    _save(figure, path)


def elastic(run: Run, stretch: np.ndarray, path: Path) -> None:
    """Draw joint errors on elastic cables beside the computed stretch."""
    figure, axes = plt.subplots(1, 2, figsize=(8, 2.4), sharex=True, layout="constrained")
    for i, ax in enumerate(axes):
        ax.plot(run.time, 1e3 * (run.q - run.q_desired)[:, i], label="joint error, case 4")
        ax.plot(run.time, 1e3 * stretch[:, i], "k--", label="computed stretch")
        ax.set(xlabel="time [s]", ylabel=f"joint {i + 1} [mrad]")
    axes[0].legend(fontsize=7)
    _save(figure, path)


def convergence(designs: Mapping[str, Design], path: Path) -> None:
    """Draw the objective over the search (Figure 10)."""
    figure, ax = plt.subplots(figsize=(6, 3), layout="constrained")
    for name, design in designs.items():
        share = 100 * np.arange(1, len(design.history) + 1) / len(design.history)
        ax.plot(share, design.history, label=f"{name}: {len(design.history)} cycles, {design.evaluations} evaluations")
    ax.set(xlabel="share of the search [%]", ylabel="larger condition number", ylim=(445, 620))
    ax.legend(fontsize=7)
    _save(figure, path)


def trajectories(series: Mapping[str, FourierSeries], path: Path) -> None:
    """Draw 60 s of trajectories and their accelerations (Figure 11)."""
    figure, axes = plt.subplots(2, 2, figsize=(8, 4.2), sharex=True, layout="constrained")
    time = np.linspace(0, 60, 1201)
    for name, one in series.items():
        q, _, a = one(time)
        for i in range(2):
            axes[0, i].plot(time, q[:, i], label=name)
            axes[1, i].plot(time, a[:, i], label=name)
    for i in range(2):
        axes[0, i].set(title=f"joint {i + 1}", ylabel="position [rad]")
        axes[1, i].set(xlabel="time [s]", ylabel="acceleration [rad/s²]")
        for sign in (-1, 1):
            axes[1, i].axhline(sign * np.pi / 48, color="r", ls=":", label="limit" if sign > 0 else None)
    axes[1, 0].legend(fontsize=7)
    _save(figure, path)


def inputs(run: Run, path: Path) -> None:
    """Draw 60 s of control input (Figure 12)."""
    figure, axes = plt.subplots(1, 2, figsize=(8, 2.4), layout="constrained")
    early = run.time <= 60
    for i, ax in enumerate(axes):
        ax.plot(run.time[early], run.tau_m[early, i])
        ax.set(xlabel="time [s]", ylabel=f"motor {i + 1} [N m]")
    _save(figure, path)


def errors(names: Sequence[str], columns, path: Path) -> None:
    """Draw predicted and actual standard errors of both designs."""
    figure, ax = plt.subplots(figsize=(7, 3), layout="constrained")
    place = np.arange(len(names))
    for k, (label, (predicted, actual, _)) in enumerate(zip(("printed, scaled", "ours"), columns, strict=True)):
        ax.bar(place + 0.4 * k - 0.2, actual, 0.36, label=f"{label}: actual")
        ax.plot(place + 0.4 * k - 0.2, [e.std for e in predicted], "k_", ms=14, label="predicted" if k else None)
    ax.set(yscale="log", ylabel="standard error [SI]", xticks=place)
    ax.set_xticklabels(names, rotation=12)
    ax.legend(fontsize=7)
    _save(figure, path)
