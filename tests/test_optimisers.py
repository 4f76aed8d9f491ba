"""The optimisers on functions whose minimum is known, and what they promise about histories, bounds, interruptions."""

from __future__ import annotations

import numpy as np
import pytest

from cdm_pin.errors import InputError
from cdm_pin.optimisers import _shares, bee_colony, covariance_adaptation

METHODS = [bee_colony, covariance_adaptation]
LOWER, UPPER = np.full(4, -2.0), np.full(4, 3.0)


def sphere(X):
    return ((X - 0.7) ** 2).sum(axis=1)


def rosenbrock(X):
    return (100 * (X[:, 1:] - X[:, :-1] ** 2) ** 2 + (1 - X[:, :-1]) ** 2).sum(axis=1)


@pytest.mark.parametrize("method", METHODS)
def test_finds_the_minimum_of_a_sphere(method):
    found = method(sphere, LOWER, UPPER, cycles=400, seed=1)
    assert found.value < 1e-8
    np.testing.assert_allclose(found.x, 0.7, atol=1e-3)


def test_adaptation_follows_a_curved_valley():
    assert covariance_adaptation(rosenbrock, LOWER, UPPER, cycles=600, seed=0).value < 1e-8


@pytest.mark.parametrize("method", METHODS)
def test_history_never_rises_and_ends_at_the_value(method):
    found = method(rosenbrock, LOWER, UPPER, cycles=50, seed=2)
    assert len(found.history) == 50
    assert (np.diff(found.history) <= 0).all()
    assert found.history[-1] == found.value == rosenbrock(found.x[None])[0]


@pytest.mark.parametrize("method", METHODS)
def test_same_seed_same_result_other_seed_other_result(method):
    one, same, other = (method(rosenbrock, LOWER, UPPER, cycles=20, seed=seed).x for seed in (3, 3, 4))
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)


@pytest.mark.parametrize("method", METHODS)
def test_candidates_stay_in_the_box(method):
    def watched(X):
        assert (X >= LOWER).all() and (X <= UPPER).all()
        return X.sum(axis=1)  # pulls towards a corner

    np.testing.assert_allclose(method(watched, LOWER, UPPER, cycles=200, seed=0).x, LOWER, atol=1e-6)


def test_twenty_bees_judge_twenty_candidates_a_cycle_and_one_more_per_scout():
    """Table 2: 20 bees, 10 food sources; the first sources are judged once."""
    few = bee_colony(sphere, LOWER, UPPER, cycles=30, population=20, limit=10**6)
    assert few.evaluations == 10 + 30 * 20
    scouting = bee_colony(lambda X: np.ones(len(X)), LOWER, UPPER, cycles=30, population=20, limit=5)
    assert scouting.evaluations > 10 + 30 * 20


def test_onlookers_choose_in_proportion_to_fitness():
    """Fitness is 1/(1 + objective); for negative objectives 1 + |objective|."""
    np.testing.assert_allclose(_shares(np.array([0.0, 1.0, 3.0])), np.array([4, 2, 1]) / 7)
    np.testing.assert_allclose(_shares(np.array([-1.0, 0.0])), [2 / 3, 1 / 3])


def test_a_start_that_is_the_minimum_is_kept():
    assert bee_colony(sphere, LOWER, UPPER, cycles=1, start=np.full(4, 0.7)).value == 0.0


def test_adaptation_begins_around_its_start():
    near, far = (covariance_adaptation(sphere, LOWER, UPPER, cycles=1, start=np.full(4, x)).value for x in (0.7, 3.0))
    assert near < far


@pytest.mark.parametrize("method", METHODS)
def test_interruption_keeps_the_best_so_far(method):
    calls = []

    def interrupted(X):
        calls.append(len(X))
        if len(calls) == 8:
            raise KeyboardInterrupt
        return sphere(X)

    found = method(interrupted, LOWER, UPPER, cycles=100, seed=0)
    assert found.interrupted
    assert found.value == sphere(found.x[None])[0]
    assert found.evaluations == sum(calls[:-1])


@pytest.mark.parametrize("method", METHODS)
def test_interruption_before_the_first_candidate_is_passed_on(method):
    def at_once(X):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        method(at_once, LOWER, UPPER, cycles=10)


@pytest.mark.parametrize("method", METHODS)
def test_what_is_not_a_number_is_never_the_best(method):
    found = method(lambda X: np.where(X[:, 0] < 0, np.nan, sphere(X)), LOWER, UPPER, cycles=100, seed=0)
    assert found.x[0] >= 0 and found.value < 1e-2


@pytest.mark.parametrize("method", METHODS)
def test_progress_runs_from_zero_to_one(method):
    seen = []
    method(sphere, LOWER, UPPER, cycles=300, progress=lambda step, fraction: seen.append((step, fraction)))
    fractions = [fraction for _, fraction in seen]
    assert fractions == sorted(fractions) and fractions[-1] == 1.0 and len(fractions) <= 300
    assert all("best so far" in step for step, _ in seen)


@pytest.mark.parametrize("method", METHODS)
def test_a_population_too_small_is_refused(method):
    with pytest.raises(InputError, match="at least 4"):
        method(sphere, LOWER, UPPER, cycles=10, population=2)
