"""Figures and the names of their places are rows of their own: each figure has a name."""

import jax.numpy as jnp
import pytest

from jaxclear.integrators.check_words import CONTACTS, LOOPS
from jaxclear.integrators.checks import Check
from jaxclear.integrators.figures import Checks
from jaxclear.simulation.found import met_by, seen_by

PLACES = {CONTACTS: ("B", "B", "D"), LOOPS: ("D",)}
SENTENCE = r"INDENTATION has 2 figures for 3 places \(B, B, D\)"


def test_figures_of_other_places_than_are_named_are_refused_as_a_run_is_traced():
    """The limit and the joint of every figure behind them would be those of another."""
    two = {Check.INDENTATION: jnp.zeros(2), Check.LOOP_DRIFT: jnp.zeros(1)}
    with pytest.raises(ValueError, match=SENTENCE):
        met_by(two, two, PLACES)
    looks = {check: jnp.tile(each, (4, 1)) for check, each in two.items()}
    with pytest.raises(ValueError, match=SENTENCE):
        seen_by(looks, jnp.arange(4.0), PLACES)


def test_checks_have_a_figure_and_a_time_for_every_named_place():
    named = ((Check.INDENTATION, PLACES[CONTACTS]), (Check.LOOP_DRIFT, PLACES[LOOPS]))
    assert set(Checks(jnp.zeros(4), jnp.zeros(4), named).figures) == {check for check, _ in named}
    with pytest.raises(ValueError, match="3 figures and 4 times for 4 named places"):
        Checks(jnp.zeros(3), jnp.zeros(4), named)
