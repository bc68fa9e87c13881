"""A nan that carries its reason hands it on through arithmetic, programs and derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.ground.outcome import Unknown
from jaxclear.native import by_columns, while_loop


@jax.custom_jvp
def lost(x):
    return x


lost.defjvp(lambda numbers, ways: (numbers[0], Unknown.GROWN.number * ways[0]))


def answer(x):
    """Of what is lost on the way, in a kernel."""
    turn = lambda carry: (carry[0] + 1, 1.5 * carry[1])
    end = while_loop(lambda carry: carry[0] < 5, turn, (jnp.zeros((), int), lost(x)))[1]
    return jnp.sum(jnp.stack([jnp.sin(end), x]) @ jnp.ones((2, 3)))


@pytest.mark.parametrize("way", [jax.jacfwd, jax.grad])
def test_a_reason_is_handed_on(way):
    found = jax.jit(way(lambda x: by_columns(answer, x)))(1.0)
    sentence = Unknown.GROWN.sentence
    assert jc.why_unknown({"slope": found}) == sentence[0].upper() + sentence[1:]


def test_of_numbers_there_is_none():
    assert jc.why_unknown([1.0, np.arange(3), np.inf]) == ""


@pytest.mark.parametrize("nan", [np.nan, -np.nan])
def test_of_any_other_nan_nothing_else_is_said(nan):
    assert jc.why_unknown(np.array([1.0, nan])).startswith("It is not a number")


def test_each_reason_is_said_once():
    both = [each.number for each in (Unknown.PARTED, Unknown.GROWN, Unknown.PARTED)]
    assert jc.why_unknown(np.array(both)).count("take") == 2
