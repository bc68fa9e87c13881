"""The choice among rungs whose errors are known functions of their steps: no mechanism runs."""

import math
from typing import NamedTuple

import numpy as np
import pytest

import jaxclear as jc
from jaxclear.errors import choice as choosing
from jaxclear.errors.choice import Question, choose_setting

RIG = jc.scenes.slider_crank()
TIMES = np.linspace(0.0, 1.0, 11)


class Run(NamedTuple):
    """A run whose answer is right to its `error`."""

    error: float
    accepted_steps: int
    rejected_steps: int = 0
    succeeded: bool = True


def ladder(step, evaluations=1, controlled=False):
    own = choosing.halving_rung(jc.integrator.FixedStep(step), RIG)
    return own._replace(evaluations=evaluations, controlled=controlled)


def steps(setting):
    return math.ceil(1 / float(setting.requested_step()) - 1e-9)


def by_order(order, constant=1.0):
    return lambda setting, share: Run(
        constant * float(setting.requested_step()) ** order, steps(setting)
    )


def choice(rungs, again, allowed, budget=None):
    seen = lambda run: run.error
    beside = lambda run, one, other: {"answer": abs(one - other) / allowed}
    return choose_setting(rungs, again, Question(seen, beside, TIMES), budget)


def test_the_coarsest_setting_is_taken_whose_error_is_within():
    """An error of half the step, first order; 2 |h - h/2| is told as exactly that."""
    found = choice([ladder(0.1)], by_order(1, 0.5), 0.0126)
    assert float(found.integrator.step) == 0.025
    assert found.error_ratio == pytest.approx(0.0125 / 0.0126) and found.reached
    assert found.work == 40
    # 0.1 to 0.00625: what stood beyond half of what is allowed wanted a second replica.
    assert found.spent == 10 + 20 + 40 + 80 + 160


def test_a_higher_order_is_told_on_the_safe_side():
    found = choice([ladder(0.1)], by_order(2), 0.01)
    assert found.error_ratio * 0.01 == pytest.approx(1.5 * float(found.integrator.step) ** 2)


def test_the_cheaper_rung_is_taken_and_no_dearer_one_is_run():
    asked = []
    own = by_order(1, 0.5)

    def again(setting, share):
        asked.append(steps(setting))
        return own(setting, share)

    found = choice([ladder(0.1, 4, True), ladder(0.1, 1)], again, 0.0126)
    assert found.work == 40 and found.integrator.step == 0.025
    found = choice([ladder(0.1, 1, True), ladder(0.1, 4)], again, 0.0126)
    assert found.work == 40
    # Of the second rung only what is cheaper than 40.
    assert asked[-1] == 10 or asked[-2:] == [80, 160]


def test_settings_that_agree_by_chance_are_told_by_the_reference():
    """Steps that pass over an impact agree in what they miss."""
    missed = lambda setting, share: Run(0.5, steps(setting))
    exact = by_order(2)
    again = lambda setting, share: (exact if float(setting.step) < 0.05 else missed)(setting, share)
    coarse, controlled = ladder(0.4), ladder(0.04, 6, controlled=True)
    found = choice([controlled, coarse], again, 0.01)
    assert float(found.integrator.step) <= 0.05
    blind = choice([coarse], again, 0.01)
    assert float(blind.integrator.step) > 0.05 or blind.reached


def test_a_setting_that_fails_is_passed_over():
    own = by_order(1, 0.5)
    again = lambda setting, share: own(setting, share)._replace(
        succeeded=float(setting.step) < 0.03
    )
    found = choice([ladder(0.1)], again, 1.0)
    assert float(found.integrator.step) == 0.025


def test_what_is_not_reached_is_said():
    found = choice([ladder(0.1)], by_order(1, 0.5), 1e-9, budget=1000)
    assert not found.reached and found.spent <= 1000
    assert "the error of answer is" in found.why and len(found.why.split()) <= 25
    # The finest of which a finer one tells: 10 + 20 + ... + 320 evaluations are 630.
    assert float(found.integrator.step) == 0.1 / 2**4


def test_where_nothing_runs_the_first_rung_is_left_to_say_why():
    found = choice(
        [ladder(0.1)], lambda setting, share: Run(0.0, 1, succeeded=False), 1.0, budget=100
    )
    assert not found.reached and "no setting tried gives an estimate" in found.why


def test_steps_that_follow_the_motion_are_not_run_where_their_first_part_is_too_dear():
    shares = []

    def again(setting, share):
        shares.append(share)
        step = setting.requested_step()
        return Run(0.0, int(1e6 * share) if step is None else steps(setting))

    found = choice([choosing._controlled(RIG), ladder(0.1)], again, 1.0, budget=1e5)
    assert shares[0] < 0.1 and isinstance(found.integrator, jc.integrator.FixedStep)
