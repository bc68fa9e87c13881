"""What is wrong with a coupling, or given against one, is said by the coupling's name."""

import warnings

import numpy as np
import pytest

import jaxclear as jc
from jaxclear.multibody.topology import Redundancy

TURN = 2 * np.pi
WHEEL = jc.Body(1.0, 1e-3)
PIN = jc.joint.Revolute()


def pair(couplings, **given):
    """Two wheels, 0.1 m apart."""
    joints = {
        "A": jc.Connection(PIN, "ground", "a"),
        "B": jc.Connection(PIN, "ground", "b", at=(0.1, 0.0)),
        "C": jc.Connection(PIN, "ground", "c", at=(0.2, 0.0)),
    }
    return jc.Mechanism(dict.fromkeys("abc", WHEEL), joints, couplings=couplings, **given)


GEAR = {"mesh": jc.coupling.Gear("A", "B", 2.0)}
Ratio = jc.coupling.Ratio


def test_couplings_that_contradict_each_other_are_warned_about():
    two = {"one": Ratio("B", "A", 2.0), "two": Ratio("B", "A", 3.0)}
    with pytest.warns(UserWarning, match='couplings "one", "two" together leave joint "B" one'):
        pair(two)
    round_ = {"ab": Ratio("A", "B", 2.0), "bc": Ratio("B", "C", 2.0), "ca": Ratio("C", "A", 2.0)}
    with pytest.warns(UserWarning, match='couplings "ab", "bc", "ca" together leave joint "A"'):
        pair(round_)


@pytest.mark.parametrize(
    "couplings",
    [
        {"one": Ratio("B", "A", 2.0), "two": Ratio("B", "A", 2.0)},
        {"ab": Ratio("A", "B", 2.0), "bc": Ratio("B", "C", 2.0), "ca": Ratio("C", "A", 0.25)},
        {"one": Ratio("B", "A", 2.0), "two": jc.coupling.Differential("A", "B", "C")},
    ],
)
def test_couplings_that_leave_motion_are_not(couplings):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pair(couplings)


def test_what_is_given_against_a_coupling_names_it():
    with pytest.raises(ValueError, match='its loops, drives, coupling "mesh" and what'):
        jc.assemble(pair(GEAR, start={"B": 1.0, "A": 1.0}))
    with pytest.raises(ValueError, match='drives, coupling "mesh" and the speeds given before'):
        jc.assemble(pair(GEAR, speeds={"B": 1.0, "A": 1.0}))


@pytest.mark.filterwarnings("ignore:.*is it in degrees")
def test_whole_turns_that_a_coupling_counts_are_met_or_said():
    with pytest.raises(ValueError, match='coupling "mesh" cannot be closed.*whole turns.*"A", "B"'):
        jc.assemble(pair(GEAR, start={"B": -7 * TURN}))
    with pytest.warns(UserWarning, match='"B" is met but for 6 whole turns.*"mesh"') as said:
        jc.assemble(pair(GEAR, guess={"B": -7 * TURN}))
    assert {each.filename for each in said} == {__file__}
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        warnings.filterwarnings("ignore", message=".*is it in degrees")
        found = jc.assemble(pair(GEAR, guess={"B": -7 * TURN, "A": 14 * TURN}))
    np.testing.assert_allclose(np.asarray(found.coordinates)[:2], (14 * TURN, -7 * TURN), atol=1e-6)


def test_redundant_rows_of_couplings_are_called_by_the_coupling():
    said = str(Redundancy(1, rows=(("two", ""), ("pin", "turn"), ("pin", "x"))))
    assert 'loops coupling "two"; turn, x of joint "pin" follow' in said
    assert said.endswith("of what the couplings transmit the least is taken.")
    assert 'joints "pin" the least' in str(Redundancy(1, rows=(("pin", "x"),), joints=("pin",)))
