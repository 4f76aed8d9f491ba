"""The page of the proof: tables and figures from the rows of trials, every sentence with a figure written here."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import proof_summary as ps
from proof_studies import STUDIES, Task, trial_words

from cdm_pin.files import write_text
from cdm_pin.plant.oracle import SURE

matplotlib.use("Agg")
from matplotlib import pyplot as plt

_BLUE, _RED, _GREY = "#0072B2", "#D55E00", "#767676"
_METHODS = {
    "diagnosis": "cdm-pin diagnose",
    "every_friction": "least squares, every friction term in, |t| > 3",
    "stepwise": "stepwise BIC, unwhitened",
    "sparse": "sparse regression (SINDy)",
}
_JUDGED = """*Met* is said of the measured value; the interval beside it tells how sure that is. The bar on false
alarms is met only if the upper end of the one-sided interval is below it.

"""
_SHOWN = 12  # rows of long tables


def write_report(rows: Sequence[ps.Row], folder: Path, page: Path) -> None:
    """Write page, tables (CSV) and figures from the rows of trials.

    Parameters
    ----------
    rows : sequence of dict
        As in trials.csv.
    folder : path
        Of tables and figures.
    page : path
        The Markdown file.
    """
    bars = ps.bars(rows)
    powers = ps.ladder_powers(rows)
    header = ("measure", "bar", "value", "interval", "n", "met")
    _write_csv(folder / "bars.csv", header, [(b.what, b.bar, b.value, b.interval, b.n, b.met) for b in bars])
    _write_csv(folder / "confusion.csv", ("true", "said_first", "count"), ps.confusion(rows))
    _write_csv(
        folder / "power.csv",
        ("effect", "n", "half_power", "slope", "visibility_at_90_percent", "low", "high"),
        [
            (name, p.n, *(f"{x:.3g}" for x in (p.half, p.slope, p.sure, p.low, p.high)))
            for name, (p, _) in powers.items()
            if p
        ],
    )
    _power_figure(powers, folder / "power.svg")
    _score_figure(rows, folder / "scores.svg")
    link = os.path.relpath(folder, page.parent)
    seeds = folder / "seeds.txt"
    word = seeds.read_text(encoding="utf-8").strip() if seeds.exists() else "?"
    parts = [
        _opening(rows, bars, word, link),
        "## Measured against its bars\n\n" + _JUDGED + _bar_table(bars),
        _power_text(powers, link),
        _encoder_text(rows),
        _set_text(rows),
        _concealed_text(rows),
        _baseline_text(rows, link),
        _confusion_text(rows, link),
        _failure_text(rows),
        _method_text(rows, word, link),
    ]
    write_text(page, "\n\n".join(part for part in parts if part) + "\n")


def _opening(rows: Sequence[ps.Row], bars: Sequence[ps.Bar], word: str, link: str) -> str:
    judged = [b for b in bars if b.met in ("met", "not met", "too few to tell")]
    met = sum(b.met == "met" for b in judged)
    return f"""# Why believe what it says is missing?

Because it was asked {len(rows)} times by someone who knew. An independent simulator conceals something in an arm:
friction, hysteresis, backlash, a soft cable, a tilted base, a law that stands in no catalogue, or nothing at all. The
diagnosis gets the recordings and a manipulator file with wrong masses. Then the seal is opened.

{met} of {len(judged)} bars are met; those that are not stand in the same table. Every trial can be made again before
your eyes from its seed, and no seed was chosen: all follow from `{word}`.
{_invitation(rows)}

![Found, by study, beside usual practice]({link}/scores.svg)"""


def _invitation(rows: Sequence[ps.Row]) -> str:
    right = next((row for row in ps.of(rows, "plain") if ps.everything(row) and row["findings"]), None)
    if right is None:
        return ""
    return f"""
Start with this one; it takes less than a minute:

```bash
{_command(right)}
```
"""


def _bar_table(bars: Sequence[ps.Bar]) -> str:
    return _table(
        ("measure", "bar", "measured", "95 % interval", "of", "met"),
        [(b.what, b.bar, b.value, b.interval, b.n, f"**{b.met}**" if b.met == "met" else b.met) for b in bars],
    )


def _power_text(powers: dict[str, Any], link: str) -> str:
    rows = [
        (name, p.n, f"{p.sure:.1f}", f"{p.low:.1f} to {p.high:.1f}", f"{p.sure / SURE:.2f}")
        for name, (p, _) in sorted(powers.items(), key=lambda item: item[1][0].sure if item[1][0] else np.inf)
        if p
    ]
    if not rows:
        return ""
    return f"""## How small may it be?

Visibility is an effect's size in units of the noise, after the masses have absorbed what they can. A matched filter
that knows effect, place and noise, but not the masses, needs {SURE} for 90 % power at 1 % false alarms: nothing can do
better. The diagnosis knows none of these and has to say name and place first. Dots are trials, lines fitted logistic
curves, grey the matched filter; the table gives the visibility found in 9 of 10 trials, with its 95 % interval.

![Power by effect]({link}/power.svg)

{_table(("effect", "trials", "visibility at 90 %", "95 % interval", "over the oracle"), rows)}"""


def _encoder_text(rows: Sequence[ps.Row]) -> str:
    costs = ps.encoder_costs(rows)
    if not costs:
        return ""
    table = _table(
        ("measure", "bar", "points lost", "95 % interval", "of", "met"),
        [(b.what, b.bar, b.value, b.interval, b.n, b.met) for b in costs],
    )
    return f"""## Coarser encoders

Points lost from 17 to 14 bits; every study is half the one and half the other.

{table}"""


def _set_text(rows: Sequence[ps.Row]) -> str:
    lines = []
    for study in ("plain", "quarter", "two", "three"):
        some = ps.of(rows, study)
        if some:
            recall, precision, exact = ps.found(some), ps.precision(some), ps.share(some, ps.everything)
            gains = [x for row in some for x in ps.numbers(row, "share")]
            gain = f"{100 * np.median(gains):.1f} %" if gains else "-"
            lines.append(
                (STUDIES[study].text, len(some), *(ps.percent(s.value) for s in (recall, precision, exact)), gain)
            )
    if not lines:
        return ""
    header = ("concealed", "trials", "found", "of what was named, right", "everything right", "share of the achievable")
    return f"""## Together

The last column is the median share of the achievable reduction of squared torque error on the unseen recording, from
the re-identified rigid body down to the noise floor.

{_table(header, lines)}"""


def _concealed_text(rows: Sequence[ps.Row]) -> str:
    usual, hidden = ps.concealed(rows)
    if not hidden:
        return ""
    right = ps.share(hidden, ps.first)
    lines = [
        (
            f"{row['effects']}, {row['places']}",
            row["visibility"],
            "between the encoders" if ps.only_kinematic(row) else f"{100 * float(row['fraction']):.3g} % of its torque",
            f"{100 * float(row['residual']):.2g} %",
            f"{100 * float(row['mass_error']):.2g} %",
            row["findings"].split(";")[0] if row["findings"] else row["verdict"] or row["failure"],
            "yes" if ps.first(row) else "no",
            f"`{row['study']}/{row['index']}`",
        )
        for row in hidden[:_SHOWN]
    ]
    header = (
        "concealed", "visibility", "what no mass absorbs", "a plain fit leaves", "masses are off by", "the tool says",
        "right", "trial",
    )  # fmt: skip
    stiff = [row for row in hidden if ps.only_kinematic(row)]
    between = ps.share(stiff, ps.first)
    return f"""## Concealed in the strict sense

Fit masses alone, by least squares, and look at what is left: in 19 of 20 recordings in which nothing is missing that is
at most {100 * usual:.2g} % of the torque. In {len(hidden)} trials with an effect of visibility 10 or more it is no more
than that either: the usual eye sees a good fit, and wrong masses if the truth were known. The tool names effect and
place in {right.k} of them ({ps.percent(right.value)}, 95 % interval {ps.between(right.interval())}). Of these,
{between.n} leave no trace in torque at all that a matched filter could find, and show only between motor and joint
encoder; {between.k} are named. Those whose masses suffer most:

{_table(header, lines)}"""


def _baseline_text(rows: Sequence[ps.Row], link: str) -> str:
    columns = {
        "plain first": "plain size: first right",
        "plain all": "everything right",
        "quarter first": "a quarter: first right",
        "quarter all": "everything right",
        "sets all": "several: everything right",
        "clean alarms": "nothing missing: something named",
        "strange named": "of no catalogue: wrong name",
    }
    lines = []
    for name, text in _METHODS.items():
        if name == "diagnosis" or any(row[name] for row in rows):
            scores = ps.baseline_scores(rows, name)
            lines.append((text, *(f"{ps.percent(s.value)} ({s.n})" for s in scores.values())))
    if len(lines) < 2:
        return ""
    left_out = "" if any(row["sparse"] for row in rows) else " The sparse-regression baseline was left out of this run."
    return f"""## Beside usual practice

The same recordings, the same scorer. The baselines know the rigid body's form and the cable map, filter positions and
torques alike and decimate; their lists of terms are shorter than the catalogue, which counts against them as it would
in practice.{left_out} In brackets: trials.

{_table(("method", *columns.values()), lines)}"""


def _confusion_text(rows: Sequence[ps.Row], link: str) -> str:
    wrong = sorted((item for item in ps.confusion(rows) if item[0] != item[1]), key=lambda item: -item[2])
    if not wrong:
        return ""
    return f"""## What is taken for what

Single effects of any visibility (the faintest cannot be seen by anyone); the whole matrix is in
[confusion.csv]({link}/confusion.csv). The commonest confusions:

{_table(("concealed", "said first", "times"), wrong[:_SHOWN])}"""


def _failure_text(rows: Sequence[ps.Row]) -> str:
    bad = [
        row
        for row in ps.of(rows, "plain", "quarter", "two", "three", "strange", "moves", "clean")
        if not ps.everything(row)
    ]
    if not bad:
        return ""
    lines = []
    for row in bad[:_SHOWN]:
        concealed = "; ".join(
            f"{e}, {p}" for e, p in zip(row["effects"].split(";"), row["places"].split(";"), strict=True)
        )
        said = row["failure"] or "; ".join([row["verdict"], *ps.listed(row, "findings")])
        lines.append((concealed.strip(", ") or "nothing", said, f"`{_command(row)}`"))
    return f"""## Where it fails

{len(bad)} trials of plain, quarter, several, none, no catalogue and from point to point are not all right.
The first of them, to be made again:

{_table(("concealed", "said", "command"), lines)}"""


def _method_text(rows: Sequence[ps.Row], word: str, link: str) -> str:
    codes = {row["code"] for row in rows}
    counts = _table(
        ("study", "trials", "concealed"),
        [(name, len(ps.of(rows, name)), study.text) for name, study in STUDIES.items()],
    )
    versions = f"{len(codes)} version{'s' if len(codes) != 1 else ''}"
    strange = ps.of(rows, "strange")
    alike = [
        f"strange/{row['index']}"
        for row in strange
        if row["unexplained"] == "1" and row["verdict"] == "missing_physics"
    ]
    faint = [f"{row['study']}/{row['index']}" for row in rows if ps.faint(row)]
    aside = f" {len(faint)} trials are left out for that: {', '.join(faint)}." if faint else ""
    return f"""## How it was done

{counts}

- **Plants**: motion and torque come from an integration in absolute link angles with cables, friction states and servo
  in the loop, or from MuJoCo; they share no code with the diagnosis (a test walks the imports). Arms of 2 to 6 links of
  some 10 N m, masses in the file wrong by up to 10 %, encoders of 17 and 14 bits, white noise or AR(1) with drift,
  clocks jittered by 5 %, joint, motor or both positions logged, 60 s at 200 Hz and as much held out. Where the arm goes
  from point to point, friction sticks while axes rest.
- **Size**: a study that asks for a visibility takes the first of 20 draws that has it, by the oracle, which knows no
  diagnosis. Where none has, as a cable may be too stiff, the trial stays in trials.csv and out of the tables.{aside}
- **No catalogue**: a law that on its recording is one of the catalogue (a dead band of an amplifier whose torque never
  changes its sign is a constant) may have that one's name, if what sets it apart is below a visibility of {SURE}, by
  the oracle; that was so in {len(alike)} of {len(strange)} trials{": " + ", ".join(alike) if alike else ""}.
- **Seal**: seeds are SHA-256 of `{word}`, the study and the trial's number. The diagnosis is handed the published files
  alone. The column `truth` of [trials.csv]({link}/trials.csv) holds the first digits of the truth's SHA-256.
- **Again**: `scripts/proof.py --show STUDY/NUMBER` prints the command that makes a trial of this page again. All of it:
  `scripts/proof.py --seeds {word}`, which takes hours and can be stopped and taken up again.
- **Score**: a finding is right by name and place, by an identity of the mechanism, or as a class that lists the effect
  among at most three others where their canonical correlation on that recording exceeds 0.95. Shares have exact
  (Clopper-Pearson) intervals. A crash or a timeout is a failure, and counted as one. Time is that of this machine.
- **Code**: {versions} of the diagnosis ({", ".join(sorted(codes))}) made these rows."""


def _command(row: ps.Row) -> str:
    index = int(row["index"])
    return Task(row["study"], index, int(row["seed"]), trial_words(row["study"], index), {}).command


def _table(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    lines = [f"| {' | '.join(header)} |", "|" + "---|" * len(header)]
    return "\n".join(lines + [f"| {' | '.join(str(cell).replace('|', '/') for cell in row)} |" for row in rows])


def _write_csv(path: Path, header: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    write_text(path, text.getvalue())


def _save(figure: Any, path: Path) -> None:
    with matplotlib.rc_context({"svg.hashsalt": "proof", "svg.fonttype": "none"}):
        figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def _power_figure(powers: dict[str, Any], path: Path) -> None:
    names = list(powers)
    if not names:
        return
    columns = 5
    lines = -(-len(names) // columns)
    figure, axes = plt.subplots(
        lines, columns, figsize=(11, 1.5 * lines + 0.6), sharex=True, sharey=True, squeeze=False
    )
    v = np.linspace(0.3, 40.0, 120)
    for axis, name in zip(axes.ravel(), names, strict=False):
        power, rows = powers[name]
        seen = np.array([ps.numbers(row, "visibility")[0] for row in rows])
        hit = np.array([not row["failure"] and ps.first(row) for row in rows], float)
        axis.plot(v, ps.oracle_power(v), color=_GREY, lw=1)
        axis.plot(seen, hit, ".", color=_BLUE, ms=3, alpha=0.6)
        if power:
            axis.plot(v, power(v), color=_BLUE, lw=1.4)
            axis.plot([power.low, power.high], [0.9, 0.9], color=_RED, lw=1.4)
        axis.set_title(name.replace("_", " "), fontsize=8)
        axis.set_xlim(0, 40)
        axis.set_ylim(-0.06, 1.06)
        axis.tick_params(labelsize=7)
    for axis in axes.ravel()[len(names) :]:
        axis.set_visible(False)
    figure.supxlabel("visibility", fontsize=9)
    figure.supylabel("found, name and place first", fontsize=9)
    figure.tight_layout()
    _save(figure, path)


def _score_figure(rows: Sequence[ps.Row], path: Path) -> None:
    groups = {"plain first": "one effect,\nplain size", "quarter first": "a quarter\nof it",
              "sets all": "two or three,\neverything right", "clean alarms": "nothing missing,\nsilent",
              "strange named": "no catalogue,\nno wrong name"}  # fmt: skip
    methods = [name for name in _METHODS if name == "diagnosis" or any(row[name] for row in rows)]
    figure, axis = plt.subplots(figsize=(8, 3.2))
    width = 0.8 / len(methods)
    for m, (name, colour) in enumerate(zip(methods, (_BLUE, _RED, "#E69F00", _GREY), strict=False)):
        scores = ps.baseline_scores(rows, name)
        axis.bar(0.0, 0.0, color=colour, label=_METHODS[name])
        for g, key in enumerate(groups):
            s = scores[key]
            if not s.n:
                continue
            turned = key in ("clean alarms", "strange named")
            s = ps.Share(s.n - s.k, s.n) if turned else s
            low, high = s.interval()
            at = g + (m - 0.5 * (len(methods) - 1)) * width
            axis.bar(at, s.value, 0.92 * width, color=colour)
            axis.plot([at, at], [low, high], color="black", lw=0.8)
    axis.set_xticks(range(len(groups)), list(groups.values()), fontsize=8)
    axis.set_ylim(0, 1.02)
    axis.set_ylabel("share of trials", fontsize=8)
    axis.tick_params(labelsize=8)
    axis.legend(fontsize=7, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncol=2, frameon=False)
    figure.tight_layout()
    _save(figure, path)
