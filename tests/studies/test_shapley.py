"""Shapley effects against closed forms: linear responses of correlated normal numbers, Ishigami's
function."""

import itertools
import math

import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.studies.statistics.scrambled import Statistic
from jaxclear.studies.statistics.sobol_indices import leading
from tests.rigs.refusals import refusals

Normal, Uniform = jc.distribution.Normal, jc.distribution.Uniform
SLOPES = np.array([1.0, -2.0, 0.5])
PAIRS = {("a", "b"): 0.6, ("b", "c"): -0.4}
MATRIX = np.array([[1.0, 0.6, 0.0], [0.6, 1.0, -0.4], [0.0, -0.4, 1.0]])


def linear(count=3, correlation=PAIRS):
    names = "abcdefghijkl"[:count]
    slopes = np.resize(SLOPES, count)
    return jc.FunctionProblem(
        lambda **x: sum(s * x[n] for s, n in zip(slopes, names, strict=True)),
        {name: jc.Dimension(1.0, Normal(1.0)) for name in names},
        correlation=correlation,
    )


# Ishigami's function: the interplay of x and z, a quarter of the variance, is shared between them:
# 0.3139 + 0.2437 / 2, 0.4424, 0.2437 / 2.
ISHIGAMI = jc.FunctionProblem(
    lambda x, y, z: jnp.sin(x) + 7 * jnp.sin(y) ** 2 + 0.1 * z**4 * jnp.sin(x),
    {name: jc.Dimension(0.0, Uniform(np.pi)) for name in "xyz"},
)
TRUTH = dict(zip("xyz", (0.43576, 0.44241, 0.12184), strict=True))


def exact(slopes, matrix):
    """By all orders: what is left of the variance of a linear response given some variables."""
    count = len(slopes)

    def explained(known):
        one, rest = list(known), [i for i in range(count) if i not in known]
        left = matrix[np.ix_(rest, rest)]
        if one and rest:
            cross = matrix[np.ix_(rest, one)]
            left = left - cross @ np.linalg.solve(matrix[np.ix_(one, one)], cross.T)
        return slopes @ matrix @ slopes - slopes[rest] @ left @ slopes[rest]

    effects = np.zeros(count)
    for order in itertools.permutations(range(count)):
        for place, variable in enumerate(order):
            effects[variable] += explained(order[: place + 1]) - explained(order[:place])
    return effects / math.factorial(count) / (slopes @ matrix @ slopes)


def test_effects_of_dependent_variables_are_those_of_the_closed_form():
    found = jc.shapley_effects(linear(), 4096)
    truth = exact(SLOPES, MATRIX)
    told = [found.effects["response", name] for name in "abc"]
    for own, value in zip(told, truth, strict=True):
        # 1.5 half widths: three intervals, of which one may miss.
        assert abs(own.value - value) < 1.5 * own.error < 0.06
    assert sum(own.value for own in told) == pytest.approx(1.0, abs=1e-12)
    assert list(found.table()["effect"]) == [own.value for own in told]
    # Of two variables alone: Owen & Prieur 2017, doi:10.1137/16M1097717, eq. for d = 2.
    half = 0.5 * 0.6**2
    two = [1 - half - 0.6 * 2 + 4 * half, 4 * (1 - half) - 0.6 * 2 + half]
    np.testing.assert_allclose(exact(SLOPES[:2], MATRIX[:2, :2]), np.array(two) / np.sum(two))


def test_effects_share_out_interplay():
    found = jc.shapley_effects(ISHIGAMI, 4096)
    for name, value in TRUTH.items():
        own = found.effects["response", name]
        assert abs(own.value - value) < 1.5 * own.error < 0.06


def test_a_surface_stands_for_its_problem_and_says_where_it_does_not():
    problem = jc.FunctionProblem(
        lambda a, b: {"fine": a - 2 * b, "rough": jnp.sin(40 * a) + 0 * b},
        {"a": jc.Dimension(0.0, Normal(1.0)), "b": jc.Dimension(0.0, Normal(1.0))},
        correlation={("a", "b"): 0.5},
    )
    found = jc.shapley_effects(jc.surface(problem), 1024)
    truth = exact(np.array([1.0, -2.0]), np.array([[1.0, 0.5], [0.5, 1.0]]))
    for name, value in zip("ab", truth, strict=True):
        own = found.effects["fine", name]
        assert abs(own.value - value) < 1.5 * own.error + 1e-9
    assert '"rough": the surface has a leave-one-out R2' in found.remark


def test_what_a_surface_leaves_open_is_in_the_errors():
    """A polynomial of degree 4 explains two thirds of Ishigami's function, or next to nothing where
    its runs are few."""
    for runs in (None, 256):
        surface = jc.surface(ISHIGAMI, runs)
        found, other = jc.shapley_effects(surface), jc.sobol_indices(surface)
        open_share = surface.error("response") ** 2 / np.var(surface.responses["response"])
        for name, value in TRUTH.items():
            own, key = found.effects["response", name], ("response", name)
            assert own.low <= value <= own.high
            # A Shapley effect lies between first order and total, Owen 2014.
            assert other.first[key].value - own.error < own.value
            assert own.value < other.total[key].value + own.error
            assert own.error > 0.9 * open_share / (1 + open_share)


def test_effects_are_as_fine_as_one_sequence_of_points_gives_them():
    """Parts of one sequence fill the gaps of each other: of Ishigami's function 1 024 samples are
    off by a third of what sixteen sequences of 64 are off by (0.0166)."""
    off, inside = [], 0
    for seed in range(10):
        found = jc.shapley_effects(ISHIGAMI, 1024, seed=seed).effects
        off += [found["response", name].value - exact for name, exact in TRUTH.items()]
        inside += sum(own.low <= TRUTH[name] <= own.high for (_, name), own in found.items())
    assert np.sqrt(np.mean(np.square(off))) < 0.01 and inside >= 26


@pytest.mark.slow
def test_many_variables_are_taken_in_orders_drawn_by_chance():
    """Independent, so that effects are shares of the sum of squares."""
    found = jc.shapley_effects(linear(12, None), 512)
    slopes = np.resize(SLOPES, 12)
    truth = slopes**2 / np.sum(slopes**2)
    told = list(found.effects.values())
    off = [abs(own.value - value) / own.error for own, value in zip(told, truth, strict=True)]
    # Of twelve 95 % intervals, two may miss, none by far.
    assert sum(one > 1 for one in off) <= 2 and max(off) < 2
    assert max(own.error for own in told) < 0.15
    assert sum(own.value for own in told) == pytest.approx(1.0)


test_what_cannot_be_asked_gets_a_sentence = refusals(
    {
        "samples of shapley_effects is 4": lambda: jc.shapley_effects(linear(), 4),
        "what is sampled is 3": lambda: jc.shapley_effects(3),
        r"contributes: jaxclear\.shapley_effects": lambda: jc.sobol_indices(linear()),
        r"% of \"a\" are not; its indices would be those of": lambda: jc.shapley_effects(
            jc.surface(linear(2, None), over=0.3)
        ),
    }
)


def test_shares_name_the_variables_that_lead():
    told = leading(
        {
            ("force", "a"): Statistic(0.6, 0.5, 0.7),
            ("force", "b"): Statistic(0.4, 0.3, 0.52),
            ("force", "c"): Statistic(0.0, 0.0, 0.1),
            ("flat", "a"): Statistic(0.0, 0.0, 0.0),
        },
        "total index",
    )
    assert told.startswith(
        '"a" (total index 0.60 ± 0.10) and "b" (total index 0.40 ± 0.12) contribute most to '
        'the variance of "force"'
    )
    assert told.endswith('"flat" does not vary with any variable.')
