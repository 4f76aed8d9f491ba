"""scripts/proof.py: a small proof with loose bounds, its bookkeeping, its statistics, its page."""

from __future__ import annotations

import importlib
import itertools
import multiprocessing
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from cdm_pin.plant.catalogue import CATALOGUE
from cdm_pin.plant.draw import draw
from cdm_pin.plant.run import altered

SCRIPTS = Path(__file__).resolve().parent.parent / "scripts"


@pytest.fixture(scope="module")
def proof():
    sys.path.insert(0, str(SCRIPTS))
    names = ("proof", "proof_studies", "proof_trial", "proof_summary", "proof_baselines", "proof_report")
    yield type("Proof", (), {name.removeprefix("proof_"): importlib.import_module(name) for name in names})
    sys.path.remove(str(SCRIPTS))


SMALL = "--links 2 --duration 30 --positions joint --motion prescribed"


def test_a_small_proof(proof):
    """A handful of short trials: silence where nothing is missing, springs and drag found where they are."""
    rows = {}
    for words, study in (("--count 0", "clean"), ("--effects joint_spring --at-least 50", "plain"),
                         ("--effects quadratic_drag --visibility 30", "ladder")):  # fmt: skip
        for index in range(2 if study == "clean" else 1):
            seed = proof.studies.seed_from_commit("a small proof", f"{study}/{index}")
            task = proof.studies.Task(study, index, seed, f"{words} {SMALL}", {"timeout": 120.0})
            rows[study, index] = proof.trial.run(task)
    assert not any(row["failure"] for row in rows.values())
    alarms = [row["verdict"] != "consistent" for (study, _), row in rows.items() if study == "clean"]
    found = [int(row["first"]) for (study, _), row in rows.items() if study != "clean"]
    assert sum(alarms) <= 1 and sum(found) >= 1
    row = rows["plain", 0]
    assert float(row["visibility"]) >= 50 and float(row["cpu"]) > 0 and row["every_friction"].count("/") == 2
    assert all(set(row) == set(proof.trial.FIELDS) for row in rows.values())


def test_time_and_death_are_rows(proof):
    """A diagnosis that takes too long, a draw that cannot be made, and a process that dies each leave a row."""
    seeds = itertools.count(1)

    def task(words, **options):
        return proof.studies.Task("plain", next(seeds), 1, words, options)

    late = task(f"--count 0 {SMALL}", timeout=0.01, baselines=False)
    impossible = task("--effects backlsh", timeout=10.0)
    slow = task("--count 0 --links 6 --recordings 30", timeout=10.0)
    ended = threading.Event()

    def end_child():  # as soon as it is at work on what takes long
        while not ended.is_set() and not multiprocessing.active_children():
            time.sleep(0.05)
        time.sleep(4.0)
        for child in multiprocessing.active_children():
            child.kill()

    rows = list(proof.proof.run_tasks(iter([late, impossible]), 1, 100.0, float("inf")))
    assert "Timeout" in rows[0]["failure"] and "did you mean 'backlash'" in rows[1]["failure"]
    thread = threading.Thread(target=end_child)
    thread.start()
    rows = list(proof.proof.run_tasks(iter([slow, impossible]), 1, 100.0, float("inf")))
    ended.set()
    thread.join()
    assert rows[0]["failure"] == "the process died" and "backlash" in rows[1]["failure"]


def test_any_beginning_is_balanced(proof):
    """The first trials are spread over all studies by their shares; seeds and arguments depend on the number alone."""
    first = list(itertools.islice(proof.studies.tasks("word"), 200))
    counts = {name: sum(task.study == name for task in first) for name in proof.studies.STUDIES}
    for name, study in proof.studies.STUDIES.items():
        assert abs(counts[name] - 200 * study.share) <= 1.5
    alone = list(itertools.islice(proof.studies.tasks("word", ("two",)), 5))
    assert alone == [task for task in first if task.study == "two"][:5]
    assert alone[0].seed != next(proof.studies.tasks("other", ("two",))).seed
    whole = list(proof.studies.tasks("word", ("three", "two")))
    assert len(whole) == sum(proof.studies.STUDIES[name].most for name in ("two", "three"))
    assert sum(study.share for study in proof.studies.STUDIES.values()) == pytest.approx(1.0)
    for task in first:
        assert {"effects", "bits", "n_recordings"} <= set(task.settings) and str(task.seed) in task.command


def test_the_ladder_covers_effects_and_visibilities(proof):
    """Every effect that masses do not swallow gets visibilities spread over the ladder."""
    rungs = [proof.studies.ladder_rung(k) for k in range(len(proof.studies.LADDER) * 30)]
    assert {name for name, _ in rungs} == set(CATALOGUE) - {"rotor_inertia", "payload"}
    for name in proof.studies.LADDER:
        own = np.array([v for effect, v in rungs if effect == name])
        assert len(own) == 30
        for low, high in ((0, 5), (5, 10), (10, 20), (20, 80)):
            assert ((own >= low) & (own < high)).sum() >= 2


def test_rows_survive_and_are_not_repeated(proof, tmp_path):
    """A line cut short is dropped; what is there is not run again; other seeds are refused."""
    path = tmp_path / "trials.csv"
    task = next(proof.studies.tasks("word"))
    proof.proof.append_row(path, proof.trial.blank(task, "x"))
    whole = path.read_text()
    path.write_text(whole + "clean,17,12")
    assert [row["index"] for row in proof.proof.read_rows(path)] == ["0"]
    proof.proof.append_row(path, proof.trial.blank(task, "y"))
    assert [row["failure"] for row in proof.proof.read_rows(path)] == ["x", "y"]
    (tmp_path / "seeds.txt").write_text("word\n")
    with pytest.raises(SystemExit, match="holds trials of the seeds 'word'"):
        proof.proof.main(["--show", "plain/1", "--seeds", "other", "-o", str(tmp_path)])


def test_show_gives_the_command(proof, tmp_path, capsys):
    """The command of a trial is printed, and nonsense refused."""
    assert proof.proof.main(["--show", "strange/3", "--seeds", "word", "-o", str(tmp_path)]) == 0
    seed = proof.studies.seed_from_commit("word", "strange/3")
    assert f"scripts/blind_trial.py --seed {seed} --count 1 --strange" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="holds no trials"):
        proof.proof.main(["--report", "-o", str(tmp_path)])
    for nonsense in ("strange", "odd/3"):
        with pytest.raises(SystemExit):
            proof.proof.main(["--show", nonsense, "-o", str(tmp_path)])


def test_shares_have_exact_intervals(proof):
    """Clopper-Pearson: textbook values, and nothing of nothing."""
    assert proof.summary.Share(0, 1000).interval(0.90) == pytest.approx((0.0, 1 - 0.05 ** (1 / 1000)))
    assert proof.summary.Share(8, 10).interval() == pytest.approx((0.4439, 0.9748), abs=1e-4)
    assert np.isnan(proof.summary.Share(0, 0).value)


def test_power_curves_are_recovered(proof):
    """In some 19 of 20 samples the visibility at 90 % power lies in its interval, which shrinks with more trials."""
    inside, widths = 0, {20: 0.0, 200: 0.0}
    for seed in range(60):
        rng, n = np.random.default_rng(seed), (20, 200)[seed % 2]
        v = rng.uniform(0.5, 40.0, n)
        hit = rng.random(n) < 1 / (1 + np.exp(-4 * np.log(v / 6.0)))
        power = proof.summary.power_curve(v, hit)
        inside += power.low < 6.0 * 9 ** (1 / 4) < power.high
        widths[n] += power.high - power.low
        assert power(np.array([power.half]))[0] == pytest.approx(0.5)
    assert inside >= 52 and widths[200] < widths[20]
    assert proof.summary.power_curve([5.0], [True]) is None
    assert proof.summary.oracle_power(np.array([3.86]))[0] == pytest.approx(0.90, abs=2e-3)


def made_up(proof, study, index, **cells):
    task = proof.studies.trial("word", study, index)
    base = {"links": 3, "bits": (17, 14)[index % 2], "positions": "joint", "verdict": "consistent", "first": 1,
            "all": 1, "false": 0, "residual": "0.01", "mass_error": "0.2", "cpu": "2", "every_friction": "0/0/3",
            "stepwise": "1/0/1"}  # fmt: skip
    row = proof.trial.blank(task, "") | base | cells
    return {key: str(value) for key, value in row.items()}


def rows_of(proof):
    rows = [made_up(proof, "clean", k, sensitivity="1.2;1.4", every_friction="0/0/3") for k in range(400)]
    told = {"verdict": "missing_physics", "effects": "coulomb_friction", "places": "joint 2", "visibility": "60",
            "kinematic": "0", "fraction": "0.8", "findings": "coulomb_friction joint 2", "meetings": "exact",
            "over_floor": "1.05", "share": "0.98", "parameters": "coulomb=0.3~0.31~0.01~0.008"}  # fmt: skip
    rows += [made_up(proof, "plain", k, **told) for k in range(20)]
    wrong = told | {"findings": "hysteresis joint 2", "meetings": "missed", "first": 0, "all": 0, "false": 1}
    rows += [made_up(proof, "ladder", k, **(wrong if k % 4 == 0 else told) | {"visibility": k + 1}) for k in range(24)]
    rows += [
        made_up(proof, "quarter", 0, failure="Timeout: more than 1 s", **dict.fromkeys(("first", "all", "false"), ""))
    ]
    return rows


def test_trials_fainter_than_asked_for_are_left_out(proof):
    """Only where the oracle says so, whatever the diagnosis made of them, and not what masses take anyway."""
    spring = {"effects": "joint_spring", "places": "joint 2"}
    last = {"effects": "encoder_offset", "places": "joint 3", "visibility": "0.1"}
    rows = [
        made_up(proof, "plain", 0, visibility="300", **spring),
        made_up(proof, "plain", 1, visibility="12", first=0, all=0, **spring),
        made_up(proof, "quarter", 2, visibility="13", **spring),
        made_up(proof, "plain", 3, **last),
        made_up(proof, "plain", 4, positions="both", **last),
        made_up(proof, "two", 5, effects="joint_spring;payload", places="joint 2;link 1", visibility="60;1e-9"),
        made_up(proof, "ladder", 6, visibility="1", **spring),
        made_up(proof, "clean", 7),
    ]
    assert [proof.summary.faint(row) for row in rows] == [False, True, False, False, True, False, False, False]
    assert len(proof.summary.of(rows, "plain")) == 2


def test_bars_are_judged(proof):
    """Counts, failures and confidence enter the table of bars as they should."""
    table = {bar.what: bar for bar in proof.summary.bars(rows_of(proof))}
    assert table["nothing missing: alarms"].met == "met" and table["nothing missing: alarms"].n == 400
    few = proof.summary.bars([made_up(proof, "clean", 0)])[0]
    assert few.met == "too few to tell"
    many = [made_up(proof, "clean", k, verdict="unexplained" if k < 30 else "consistent") for k in range(300)]
    assert proof.summary.bars(many)[0].met == "not met"
    assert table["one effect at plain size: name and place first"].value == "100.0 %"
    assert table["one effect at a quarter: name and place first"].value == "0.0 %"  # it took too long
    assert table["visibility 0-80: a wrong name anywhere"].met == "not met"
    assert table["diagnoses that failed or took too long"].value.startswith("0.2")
    assert table["true value inside the stated 95 % interval, where everything is right"].value == "100.0 %"
    assert table["stated standard error over the Cramer-Rao bound (median)"].value == "1.25"


def test_page_is_written(proof, tmp_path):
    """Page, tables and figures follow from the rows alone, the same each time, without a number typed by hand."""
    pages = []
    for name in ("one", "two"):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "seeds.txt").write_text("word\n")
        proof.report.write_report(rows_of(proof), folder, folder / "proof.md")
        pages.append([(folder / file).read_bytes() for file in ("proof.md", "power.svg", "scores.svg", "bars.csv")])
    assert pages[0] == pages[1]
    page = pages[0][0].decode()
    assert "asked 445 times" in page and "hysteresis" in page and "scripts/blind_trial.py --seed" in page
    assert (tmp_path / "one" / "confusion.csv").read_text().count("coulomb_friction") == 3


def test_baselines_see_what_usual_practice_sees(proof):
    """A plain fit of a clean arm is good; strong viscous friction biases masses, is named by both baselines."""
    clean, rubbing = (
        draw(1, effects=effects, n_links=2, positions="joint", bits=17, motion="prescribed", noise="white",
             duration=30.0, n_holdout=0)
        for effects in ([], ["viscous_friction"])
    )  # fmt: skip
    fits = []
    for trial in (clean, rubbing):
        plain = proof.baselines.prepare(trial.manipulator, trial.recordings[0])
        fits.append(proof.baselines.rigid_fit(plain, altered(trial.scene.arm, trial.scene.faults)[0]))
    assert fits[0]["residual"] < 0.02 and fits[0]["error"] < 0.02 and fits[1]["residual"] > fits[0]["residual"]
    names = [
        {f["effect"] for f in method(plain)} for method in (proof.baselines.every_friction, proof.baselines.stepwise)
    ]
    assert all("viscous_friction" in found for found in names)
