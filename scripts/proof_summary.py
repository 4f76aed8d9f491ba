"""From the rows of trials to the figures of the proof: shares with exact intervals, power curves, bars met or not."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from proof_studies import STUDIES
from scipy.stats import beta, norm

from cdm_pin.plant.oracle import SURE
from cdm_pin.scoring import in_rigid_body

Row = dict[str, str]
SINGLE = ("plain", "quarter", "ladder")
_ALARM = 0.01  # of the oracle


@dataclass(frozen=True)
class Share:
    """`k` of `n`."""

    k: int
    n: int

    @property
    def value(self) -> float:
        """The share; NaN of none."""
        return self.k / self.n if self.n else np.nan

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Exact (Clopper-Pearson) interval."""
        tail = 0.5 * (1.0 - level)
        low = beta.ppf(tail, self.k, self.n - self.k + 1) if self.k else 0.0
        high = beta.ppf(1.0 - tail, self.k + 1, self.n - self.k) if self.k < self.n else 1.0
        return float(low), float(high)


@dataclass(frozen=True)
class Bar:
    """One line of the table of bars: what, the bar in words, the value, its interval, from how many, met or not."""

    what: str
    bar: str
    value: str
    interval: str
    n: int
    met: str


def numbers(row: Row, name: str) -> list[float]:
    """Read a cell that lists numbers."""
    return [float(x) for x in row[name].split(";") if x]


def listed(row: Row, name: str) -> list[str]:
    """Read a cell that lists words."""
    return [x for x in row[name].split(";") if x]


def of(rows: Iterable[Row], *studies: str) -> list[Row]:
    """Pick the trials of some studies, those aside that are fainter than their study asks for."""
    return [row for row in rows if row["study"] in studies and not faint(row)]


def faint(row: Row) -> bool:
    """Whether the plant drew, time and again, nothing as visible as the study asks for; the oracle says so.

    What lies in the span of the masses is never visible, and concealed nevertheless.
    """
    least = STUDIES[row["study"]].least
    shown = zip(listed(row, "effects"), row["places"].split(";"), numbers(row, "visibility"), strict=False)
    return any(x < least and not _in_span(row, effect, place) for effect, place, x in shown)


def in_share(rows: Sequence[Row]) -> list[Row]:
    """Leave out what single studies have beyond their share, so that one continued alone does not outweigh."""
    count = Counter(row["study"] for row in rows)
    whole = np.median([n / STUDIES[study].share for study, n in count.items()]) if count else 0.0
    seen, out = Counter[str](), []
    for row in sorted(rows, key=lambda row: int(row["index"])):
        seen[row["study"]] += 1
        if seen[row["study"]] <= np.ceil(whole * STUDIES[row["study"]].share):
            out.append(row)
    return out


def share(rows: Sequence[Row], right: Callable[[Row], bool]) -> Share:
    """Count the rows for which something holds; of a diagnosis that failed nothing does."""
    return Share(sum(not row["failure"] and right(row) for row in rows), len(rows))


def first(row: Row) -> bool:
    """Whether the strongest finding is right in name and place."""
    return row["first"] == "1"


def everything(row: Row) -> bool:
    """Whether everything is right and nothing false beside it."""
    return row["all"] == "1"


def alarm(row: Row) -> bool:
    """Whether something was named or said to be unexplained; a diagnosis that failed said nothing."""
    return row["verdict"] in ("missing_physics", "unexplained") or bool(row["findings"])


def wrongly_named(row: Row) -> bool:
    """Whether any finding meets nothing that is there."""
    return not row["failure"] and int(row["false"]) > 0


def within(rows: Iterable[Row], low: float, high: float) -> list[Row]:
    """Pick single-effect trials by visibility."""
    return [row for row in rows if low <= (numbers(row, "visibility") or [-1.0])[0] < high]


def rigid(row: Row) -> bool:
    """Whether the one effect of a trial lies in the span of the masses."""
    return _in_span(row, row["effects"], row["places"])


def _in_span(row: Row, effect: str, place: str) -> bool:
    location = {"index": int(place.split()[1])} if effect == "encoder_offset" else {}
    return in_rigid_body({"effect": effect, "location": location}, int(row["links"]), row["positions"])


def found(rows: Iterable[Row]) -> Share:
    """Count the effects found among all those of trials with several."""
    met = [meeting for row in rows for meeting in listed(row, "meetings") or ["missed"] * len(listed(row, "effects"))]
    return Share(sum(m != "missed" for m in met), len(met))


def precision(rows: Iterable[Row]) -> Share:
    """Count the right ones among all findings."""
    rows = [row for row in rows if not row["failure"]]
    named, false = sum(len(listed(row, "findings")) for row in rows), sum(int(row["false"]) for row in rows)
    return Share(named - false, named)


@dataclass(frozen=True)
class Parameter:
    """An estimate: truth, value, stated standard error, Cramer-Rao bound."""

    name: str
    true: float
    value: float
    std: float
    bound: float


def estimates(rows: Iterable[Row]) -> list[Parameter]:
    """List the parameters of exactly met effects."""
    out = []
    for row in rows:
        for item in listed(row, "parameters"):
            name, values = item.split("=")
            out.append(Parameter(name, *(float(x) for x in values.split("~"))))
    return [p for p in out if p.std > 0]


@dataclass(frozen=True)
class Power:
    """A power curve, logistic in the logarithm of visibility: most likely values and the 95 % interval of its 90 %."""

    half: float
    slope: float
    sure: float
    low: float
    high: float
    n: int

    def __call__(self, visibility: np.ndarray) -> np.ndarray:
        """Probability of being found."""
        return 1.0 / (1.0 + np.exp(-self.slope * (np.log(visibility) - np.log(self.half))))


def power_curve(visibility: Sequence[float], hit: Sequence[bool]) -> Power | None:
    """Fit a power curve on a grid of half-power visibilities (1-200) and slopes, both flat before the data.

    None for fewer than three trials.
    """
    if len(hit) < 3:
        return None
    half, slope = np.log(np.geomspace(1.0, 200.0, 140)), np.geomspace(1.0, 16.0, 40)
    x, y = np.log(np.maximum(visibility, 1e-3)), np.asarray(hit, bool)
    z = slope[None, :, None] * (x[None, None, :] - half[:, None, None])
    fit = -np.logaddexp(0.0, np.where(y, -z, z)).sum(axis=2)
    weight = np.exp(fit - fit.max())
    i, j = np.unravel_index(np.argmax(fit), fit.shape)
    sure = np.exp(half[:, None] + np.log(9.0) / slope[None, :])
    order = np.argsort(sure.ravel())
    total = np.cumsum(weight.ravel()[order])
    low, middle, high = (float(sure.ravel()[order][np.searchsorted(total, q * total[-1])]) for q in (0.025, 0.5, 0.975))
    return Power(float(np.exp(half[i])), float(slope[j]), middle, low, high, len(hit))


def oracle_power(visibility: np.ndarray) -> np.ndarray:
    """Power of a matched filter at 1 % false alarms."""
    return norm.cdf(visibility - norm.isf(_ALARM / 2))


def percent(x: float) -> str:
    """Write a share in per cent."""
    return "-" if np.isnan(x) else f"{100 * x:.1f} %"


def between(pair: tuple[float, float]) -> str:
    """Write an interval of shares in per cent."""
    return f"{100 * pair[0]:.1f} to {100 * pair[1]:.1f} %"


def share_bar(what: str, s: Share, bar: float | None, *, most: bool = False) -> Bar:
    """Hold a share against the least (or, with `most`, the largest) that is allowed."""
    if bar is None or not s.n:
        met = "-"
    else:
        met = "met" if (s.value <= bar if most else s.value >= bar) else "not met"
    words = "-" if bar is None else f"{'at most' if most else 'at least'} {100 * bar:g} %"
    return Bar(what, words, percent(s.value), between(s.interval()) if s.n else "-", s.n, met)


def quantile_bar(what: str, values: Sequence[float], most: float | None, level: float = 0.5, unit: str = "") -> Bar:
    """Hold a quantile of values against the largest that is allowed; its interval comes from order statistics."""
    x = np.sort([v for v in values if np.isfinite(v)])
    words = "-" if most is None else f"at most {most:g}{unit}"
    if not len(x):
        return Bar(what, words, "-", "-", 0, "-")
    value = float(np.quantile(x, level))
    spread = 1.96 * np.sqrt(len(x) * level * (1.0 - level))
    ends = [x[int(np.clip(round(len(x) * level + s * spread) - (s > 0), 0, len(x) - 1))] for s in (-1, 1)]
    met = "-" if most is None else "met" if value <= most else "not met"
    return Bar(what, words, f"{value:.3g}{unit}", f"{ends[0]:.3g} to {ends[1]:.3g}{unit}", len(x), met)


def clean_bar(rows: Sequence[Row]) -> Bar:
    """Hold false alarms against 1 % with 95 % confidence."""
    s = share(rows, alarm)
    upper = s.interval(0.90)[1] if s.n else 1.0
    met = "met" if upper <= 0.01 else "not met" if s.n and s.interval(0.90)[0] > 0.01 else "too few to tell"
    what = "nothing missing: alarms"
    return Bar(what, "at most 1 %, with 95 % confidence", percent(s.value), between(s.interval()) if s.n else "-",
               s.n, met if s.n else "-")  # fmt: skip


def coverage_bar(what: str, told: Sequence[Parameter], judged: bool) -> Bar:
    """Count the parameters whose true value lies in the stated interval; too many is as wrong as too few."""
    s = Share(sum(abs(p.value - p.true) <= 1.96 * p.std for p in told), len(told))
    met = "-" if not (s.n and judged) else "met" if 0.90 <= s.value <= 0.98 else "not met"
    interval = between(s.interval()) if s.n else "-"
    return Bar(what, "90 to 98 %" if judged else "-", percent(s.value), interval, s.n, met)


def encoder_costs(rows: Sequence[Row]) -> list[Bar]:
    """Compare 17 and 14 bits, measure by measure and (the last) all together."""
    measures = [
        ("one effect at plain size, first right", of(rows, "plain"), first),
        ("one effect at plain size, everything right", of(rows, "plain"), everything),
        ("one effect at a quarter, first right", of(rows, "quarter"), first),
        ("one effect at a quarter, everything right", of(rows, "quarter"), everything),
        ("nothing missing: silent", of(rows, "clean"), lambda row: not alarm(row)),
        ("visibility 5-80, first right", within(of(rows, "ladder"), 5, 81), first),
        ("two or three effects, everything right", of(rows, "two", "three"), everything),
        ("of no catalogue, unexplained at its joint", of(rows, "strange"), lambda row: row["unexplained"] == "1"),
    ]
    out, pooled = [], {bits: Share(0, 0) for bits in ("17", "14")}
    for what, some, right in measures:
        by_bits = {bits: share([row for row in some if row["bits"] == bits], right) for bits in pooled}
        if all(s.n for s in by_bits.values()):
            out.append(_cost(what, by_bits["17"], by_bits["14"]))
            pooled = {bits: Share(s.k + by_bits[bits].k, s.n + by_bits[bits].n) for bits, s in pooled.items()}
    return [*out, _cost("14 instead of 17 bits: all measures together", pooled["17"], pooled["14"])] if out else []


def _cost(what: str, fine: Share, coarse: Share) -> Bar:
    """Points lost from `fine` to `coarse`, with Newcombe's interval."""
    cost = fine.value - coarse.value
    (fl, fh), (cl, ch) = _wilson(fine), _wilson(coarse)
    low = cost - np.hypot(fine.value - fl, ch - coarse.value)
    high = cost + np.hypot(fh - fine.value, coarse.value - cl)
    met = "met" if cost <= 0.05 else "not met"
    interval = f"{100 * low:.1f} to {100 * high:.1f} points"
    return Bar(what, "at most 5 points", f"{100 * cost:.1f} points", interval, fine.n + coarse.n, met)


def _wilson(s: Share) -> tuple[float, float]:
    z = 1.96
    middle = (s.value + z * z / (2 * s.n)) / (1 + z * z / s.n)
    half = z / (1 + z * z / s.n) * np.sqrt(s.value * (1 - s.value) / s.n + z * z / (4 * s.n**2))
    return float(middle - half), float(middle + half)


def aside(words: str, rows: Sequence[Row], measures: Mapping[str, Callable[[Row], bool]]) -> list[Bar]:
    """Give what a study of one effect or nothing came to, of which no bar is asked."""
    some, none = ([row for row in rows if bool(row["effects"]) == there] for there in (True, False))
    told = [share_bar(f"{words}, one effect: {name}", share(some, holds), None) for name, holds in measures.items()]
    return [*told, share_bar(f"{words}, nothing missing: alarms", share(none, alarm), None)]


def bars(rows: Sequence[Row]) -> list[Bar]:
    """Hold every measure against its bar."""
    plain, quarter, ladder = (of(rows, name) for name in SINGLE)
    sets, strange, clean = of(rows, "two", "three"), of(rows, "strange"), of(rows, "clean")
    met_exactly = of(rows, *SINGLE, "two", "three")
    told = estimates([row for row in met_exactly if everything(row)])
    ratios = [p.std / p.bound for p in told if p.bound > 0]
    bodies = [row for row in [*plain, *quarter] if row["effects"] and rigid(row)]
    timed, name = in_share(rows), {"name and place first": first}
    return [
        clean_bar(clean),
        quantile_bar("nothing missing: amplitude that would have been seen, over the oracle's (median)",
                     [x for row in clean for x in numbers(row, "sensitivity")], 1.6),
        share_bar("one effect at plain size: name and place first", share(plain, first), 0.99),
        share_bar("one effect at plain size: everything right, nothing false", share(plain, everything), 0.96),
        share_bar("one effect at a quarter: name and place first", share(quarter, first), 0.99),
        share_bar("one effect at a quarter: everything right, nothing false", share(quarter, everything), 0.96),
        share_bar("visibility 5-10: name and place first", share(within(ladder, 5, 10), first), 0.90),
        share_bar("visibility 10-20: name and place first", share(within(ladder, 10, 20), first), 0.95),
        share_bar("visibility 20-80: name and place first", share(within(ladder, 20, 81), first), 0.99),
        share_bar("visibility 0-80: a wrong name anywhere", share(ladder, wrongly_named), 0.02, most=True),
        share_bar("two or three effects: found", found(sets), 0.97),
        share_bar("two or three effects: everything right, nothing false", share(sets, everything), 0.85),
        share_bar("of no catalogue: unexplained, at the right joint",
                  share(strange, lambda row: row["unexplained"] == "1"), 0.97),
        share_bar("of no catalogue: no wrong name", share(strange, lambda row: not wrongly_named(row)), 0.90),
        quantile_bar("torque error on the unseen run over the floor, one effect (median)",
                     [x for row in [*plain, *quarter] for x in numbers(row, "over_floor")], 1.1),
        quantile_bar("torque error on the unseen run over the floor, several effects (median)",
                     [x for row in sets for x in numbers(row, "over_floor")], 1.1),
        quantile_bar("the same over the torque noise that the simulator put there (median)",
                     [x for row in [*plain, *quarter, *sets] for x in numbers(row, "over_noise")], None),
        coverage_bar("true value inside the stated 95 % interval, where everything is right", told, True),
        coverage_bar("true value inside the stated 95 % interval, of all that was named exactly",
                     estimates(met_exactly), False),
        quantile_bar("stated standard error over the Cramer-Rao bound (median)", ratios, 2.0),
        quantile_bar("stated standard error over the Cramer-Rao bound (9 of 10 below)", ratios, 2.0, 0.9),
        *encoder_costs(rows)[-1:],
        share_bar("rotor, payload, last encoder: listed as the class they are",
                  share(bodies, lambda row: "missed" not in row["meetings"]), None),
        quantile_bar("processor time of a diagnosis, 3 links (median)",
                     [x for row in timed if row["links"] == "3" for x in numbers(row, "cpu")], 3.0, unit=" s"),
        quantile_bar("processor time of a diagnosis, all (median)",
                     [x for row in timed for x in numbers(row, "cpu")], None, unit=" s"),
        *aside("moved by MuJoCo", of(rows, "mujoco"), name),
        *aside("moved from point to point", of(rows, "moves"), name | {"everything right, nothing false": everything}),
        *aside("several recordings", of(rows, "several"), name),
        share_bar("diagnoses that failed or took too long", Share(sum(bool(r["failure"]) for r in rows), len(rows)),
                  None),
    ]  # fmt: skip


def confusion(rows: Iterable[Row]) -> list[tuple[str, str, int]]:
    """Count, for single effects, what was said first: (true, said, count)."""
    counts: Counter[tuple[str, str]] = Counter()
    for row in of(rows, *SINGLE):
        effects, said = listed(row, "effects"), listed(row, "findings")
        if len(effects) != 1:
            continue
        if row["failure"]:
            name = "failure"
        elif first(row):
            name = effects[0]
        elif said:
            name = said[0].split()[0] + (" (elsewhere)" if said[0].split()[0] == effects[0] else "")
        else:
            name = row["verdict"]
        counts[effects[0], name] += 1
    return [(true, name, count) for (true, name), count in sorted(counts.items())]


def ladder_powers(rows: Iterable[Row]) -> dict[str, tuple[Power | None, list[Row]]]:
    """Fit the power curve of each effect, and of all together first."""
    ladder = [row for row in of(rows, "ladder") if numbers(row, "visibility") and not rigid(row)]
    out = {}
    for name in ["all effects", *sorted({row["effects"] for row in ladder})]:
        own = [row for row in ladder if name in ("all effects", row["effects"])]
        seen = [numbers(row, "visibility")[0] for row in own]
        out[name] = (power_curve(seen, [not row["failure"] and first(row) for row in own]), own)
    return out


def only_kinematic(row: Row) -> bool:
    """Whether the torque alone would not show a single effect to a matched filter, but the two encoders do."""
    seen, between = numbers(row, "visibility")[0], numbers(row, "kinematic")[0]
    return between > SURE and seen**2 - between**2 < SURE**2


def concealed(rows: Iterable[Row]) -> tuple[float, list[Row]]:
    """Pick single effects of visibility 10 and more that a plain fit of the masses leaves no trace of.

    Returns
    -------
    usual : float
        What a plain fit leaves over in 19 of 20 recordings in which nothing is missing, relative to the torque.
    rows : list of Row
        Those whose residual is no larger, the most wrong masses first.
    """
    rows = list(rows)
    clean = [x for row in of(rows, "clean") for x in numbers(row, "residual")]
    usual = float(np.quantile(clean, 0.95)) if clean else 0.02
    hidden = [
        row
        for row in of(rows, *SINGLE)
        if row["effects"]
        and not rigid(row)
        and (numbers(row, "visibility") or [0.0])[0] >= 10
        and (numbers(row, "residual") or [np.inf])[0] <= usual
    ]
    return usual, sorted(hidden, key=lambda row: -numbers(row, "mass_error")[0])


_BASELINE_SCORES = (  # studies, what is counted, and where it stands in first/all/false
    ("plain", "first", 0), ("plain", "all", 1), ("quarter", "first", 0), ("quarter", "all", 1), ("sets", "all", 1),
    ("clean", "alarms", 2), ("strange", "named", 2),
)  # fmt: skip


def baseline_scores(rows: Iterable[Row], name: str) -> dict[str, Share]:
    """Score a baseline (a column of rows, or "diagnosis") on the trials where every one of them has an answer."""
    rows = list(rows)
    rows = [row for row in rows if row["every_friction"]] or rows
    out = {}
    for study, what, index in _BASELINE_SCORES:
        some = of(rows, *(("two", "three") if study == "sets" else (study,)))
        if name == "diagnosis":
            cells = [(row["first"] or 0, row["all"] or 0, alarm(row) if study == "clean" else row["false"] or 0)
                     for row in some]  # fmt: skip
        else:
            cells = [tuple(row[name].split("/")) for row in some if row[name]]
        out[f"{study} {what}"] = Share(sum(int(cell[index]) > 0 for cell in cells), len(cells))
    return out
