"""The trials of the proof: which there are, in what order, and the arguments of `blind_trial.py` that make each again.

Their order is one list in which every study keeps its share, so that any beginning of it is a small proof.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from blind_trial import add_trial_arguments, seed_from_commit, trial_settings

from cdm_pin.plant.catalogue import CATALOGUE

PLAIN = 50.0  # least visibility of what a mechanic would call a fault
LADDER = tuple(name for name in CATALOGUE if name not in ("rotor_inertia", "payload"))  # never visible beside masses
_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
_TOP, _STEEP, _SHARE = 80.0, 30.0, 0.8  # highest visibility; where the power curve has been climbed; draws up to there


@dataclass(frozen=True)
class Study:
    """One kind of trial.

    Parameters
    ----------
    share : float
        Of all trials, as long as there are more to come.
    most : int
        How many trials it has.
    text : str
        What is concealed.
    words : callable
        The arguments of trial `index`.
    least : float
        Visibility that is asked for.
    """

    share: float
    most: int
    text: str
    words: Callable[[int], str]
    least: float = 0.0


def _bits(index: int) -> str:
    return f"--bits {(17, 14)[index % 2]}"


def ladder_rung(index: int) -> tuple[str, float]:
    """Give effect and visibility of a trial of the ladder: each effect once per round, at evenly spread visibilities.

    Four fifths are below 30, where the power curve climbs, the rest evenly in the logarithm from there to 80.
    """
    around, j = divmod(index, len(LADDER))
    effect = (j * 11 + around) % len(LADDER)
    u = ((around + 1) * _GOLDEN + 7 * effect / len(LADDER)) % 1.0
    visibility = _STEEP * u / _SHARE if u < _SHARE else _STEEP * (_TOP / _STEEP) ** ((u - _SHARE) / (1.0 - _SHARE))
    return LADDER[effect], round(max(visibility, 0.5), 2)


def _ladder(index: int) -> str:
    effect, visibility = ladder_rung(index)
    return f"--effects {effect} --visibility {visibility} {_bits(index + index // len(LADDER))}"


def _several(index: int) -> str:
    vary = ("pretension", "pretension payload")[index % 2]
    return f"--count {index // 2 % 2} --recordings 2 --vary {vary} {_bits(index)}"


STUDIES = {
    "clean": Study(0.33, 1200, "nothing", lambda k: f"--count 0 {_bits(k)}"),
    "plain": Study(0.13, 500, "one effect at plain size", lambda k: f"--count 1 {_bits(k)}", PLAIN),
    "quarter": Study(
        0.08,
        400,
        "one effect at a quarter of that size",
        lambda k: f"--count 1 --size quarter {_bits(k)}",
        PLAIN / 4,
    ),
    "ladder": Study(0.18, 100 * len(LADDER), "each effect at visibilities up to 80", _ladder),
    "two": Study(0.06, 250, "two effects at plain size", lambda k: f"--count 2 {_bits(k)}", PLAIN),
    "three": Study(0.04, 150, "three effects at plain size", lambda k: f"--count 3 {_bits(k)}", PLAIN),
    "strange": Study(0.08, 400, "a law that no catalogue has", lambda k: f"--count 1 --strange {_bits(k)}", PLAIN),
    "mujoco": Study(
        0.02,
        150,
        "nothing or one effect, moved by MuJoCo",
        lambda k: f"--plant mujoco --count {min(k % 3, 1)} {_bits(k)}",
        PLAIN,
    ),
    "moves": Study(
        0.06,
        300,
        "nothing or one effect at plain size, moved from point to point with friction that sticks",
        lambda k: f"--motion moves --count {min(k % 3, 1)} {_bits(k // 3)}",
        PLAIN,
    ),
    "several": Study(0.02, 150, "nothing or one effect, in recordings under different conditions", _several),
}


def trial_words(study: str, index: int) -> str:
    """Give the arguments of `blind_trial.py` of a trial."""
    its = STUDIES[study]
    return its.words(index) + (f" --at-least {its.least}" if its.least else "")


@dataclass(frozen=True)
class Task:
    """One trial to run: study, index in it, seed, and the arguments of `blind_trial.py`."""

    study: str
    index: int
    seed: int
    words: str
    options: dict[str, Any]

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of `cdm_pin.plant.draw.draw`."""
        parser = argparse.ArgumentParser(exit_on_error=False)
        add_trial_arguments(parser)
        return trial_settings(parser.parse_args(self.words.split()))

    @property
    def command(self) -> str:
        """The command that makes this trial again."""
        return f"scripts/blind_trial.py --seed {self.seed} {self.words}"


def tasks(word: str, only: tuple[str, ...] = (), more: str = "", **options: Any) -> Iterator[Task]:
    """List the trials, every study in its share until it has them all.

    Parameters
    ----------
    word : str
        Seeds follow from it: a commit hash, or any word for trials that nothing is reported from.
    only : tuple of str
        Studies; all by default.
    more : str
        Further arguments of every trial.
    options
        Handed to the trial.
    """
    studies = {name: STUDIES[name] for name in only or STUDIES}
    done = dict.fromkeys(studies, 0)
    while rest := [name for name in studies if done[name] < studies[name].most]:
        name = min(rest, key=lambda s: ((done[s] + 0.5) / studies[s].share, s))
        yield trial(word, name, done[name], more, **options)
        done[name] += 1


def trial(word: str, study: str, index: int, more: str = "", **options: Any) -> Task:
    """Give one trial; arguments as `tasks`."""
    words = " ".join([trial_words(study, index), more]).strip()
    return Task(study, index, seed_from_commit(word, f"{study}/{index}"), words, options)
