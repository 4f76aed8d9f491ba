"""Unseen recordings: what laws leave open about standstills is told by the recordings that hold these."""

from types import SimpleNamespace

import numpy as np
import pytest

from cdm_pin import judging
from cdm_pin.body_effects import ripple_grid
from cdm_pin.fit import left_open
from cdm_pin.search import foretold
from cdm_pin.unseen import loosened

SIGN = np.sign(np.sin(np.linspace(0.0, 20.0, 400)))
PASSAGE = np.exp(-(np.linspace(-30.0, 30.0, 400) ** 2))


def other_recording(torque):
    """Give recordings with that torque on one motor, and friction with what its sign leaves open."""
    friction = [np.stack([SIGN, PASSAGE])[:, None]]
    return SimpleNamespace(
        problem=SimpleNamespace(segments=[[(0, 400)]]),
        rigid=[np.zeros((0, 1, 400))],
        nominal=[torque[None]],
        loads=np.ones(1),
        columns=lambda law: friction,
    )


def fitted(open_by):
    """Give a fit of friction of 2 N m, and of so much that its sign leaves open, to some recordings."""
    law = SimpleNamespace(effect=SimpleNamespace(signs=(1,)), bare="the sign alone")
    beta = (np.array([2.0, open_by]),)
    return SimpleNamespace(problem=None, effects=(law,), base=np.zeros(0), beta=beta, covariance=np.eye(2))


@pytest.mark.parametrize(("passes", "open_by", "rest"), [(0.0, 90.0, 0.0), (3.0, 3.0, 0.0), (3.0, 90.0, 3.0)])
def test_what_is_left_open_is_not_foretold_where_the_law_alone_errs_less(passes, open_by, rest):
    """Coefficients fitted to rests say nothing of other passages; those that hold there, too, stay."""
    errors = foretold(other_recording(2.0 * SIGN + passes * PASSAGE), fitted(open_by))
    assert np.abs(errors[0]).max() == pytest.approx(rest, abs=0.05)


def test_what_is_left_open_may_be_anything_elsewhere():
    """Its variance is that of friction, or of itself where that is more; the law's own stays."""
    for open_by, spread in ((90.0, 90.0), (0.1, 2.0)):
        fit = fitted(open_by)
        assert [own.tolist() for own in left_open(fit)] == [[1]]
        assert np.diag(loosened(fit, np.zeros((2, 2)), [np.arange(2)])) == pytest.approx([0.0, spread**2])


@pytest.mark.parametrize(("turns", "whole"), [(0.8, False), (40.0, True)])
def test_a_ripple_over_many_turns_repeats_with_each(turns, whole):
    """A geared motor has hundreds of turns, which tell thousands of orders apart; only whole ones are a motor's."""
    angle = np.pi * turns * np.sin(np.linspace(0.0, 6.0, 3000))
    motion = SimpleNamespace(q_m=angle[:, None], v_m=np.gradient(angle, 0.01)[:, None], rate=100.0)
    orders = np.array(ripple_grid([motion], SimpleNamespace(index=(0,))))[:, 0]
    assert np.all(orders == np.round(orders)) == whole
    assert len(orders) < 300


@pytest.mark.parametrize(("closed", "opened", "opens"), [(6000, 2500, True), (3000, 2500, False), (6000, 5500, False)])
def test_signs_are_left_open_where_unseen_recordings_ask(monkeypatch, closed, opened, opens):
    """Not where the law alone leaves little more than noise (2500 here), nor where that takes little away."""
    law = SimpleNamespace(has_doubts=True, detailed=lambda motions: "left open")
    body = SimpleNamespace(data=np.zeros(2500))
    judge = SimpleNamespace(body=lambda whitener: body)
    fits = {False: SimpleNamespace(effects=(law,), whitener="noise"), True: SimpleNamespace(whitener="noise")}
    search = SimpleNamespace(problem=SimpleNamespace(motions=()), fit=lambda laws, whitener: fits[True])
    explanation = SimpleNamespace(search=search, fit=fits[False], bank=None)
    monkeypatch.setattr(judging, "deviance_unseen", lambda judge, fit: closed if fit is fits[False] else opened)
    monkeypatch.setattr(judging, "tuned", lambda search, laws, whitener: laws)
    monkeypatch.setattr(judging, "explained", lambda search, bank, laws: laws)
    assert judging._opened(judge, explanation) == (["left open"] if opens else explanation)
