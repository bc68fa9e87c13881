"""Variables of several numbers under one name: shifts in discs and balls against closed forms, one
row in every table, one share of every variance."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

import jaxclear as jc
from tests.rigs.cells import slow
from tests.rigs.refusals import refusals

D = jc.distribution
R, SPREAD = 15e-6, 4e-6
SLOPE = np.array([0.6, -1.1])


def problem(function=None, **more):
    """A shift in a disc beside a number of its own."""
    linear = lambda pin, gap: {"error": SLOPE[0] * pin[0] + SLOPE[1] * pin[1] + 2.0 * gap}
    variables = {
        "pin": jc.Dimension((0.0, 0.0), D.Ball(R)),
        "gap": jc.Dimension(0.0, D.Normal(SPREAD)),
    }
    return jc.FunctionProblem(function or linear, variables, **more)


PIN, GAP = (R / 2) ** 2 * SLOPE @ SLOPE, (2.0 * SPREAD) ** 2


@pytest.mark.parametrize("dimension", [2, *slow(3)])
def test_points_fill_a_disc_and_a_ball_evenly(dimension):
    """The share within a radius r is (r/R)^k, the variance of a coordinate R^2 / (k + 2)."""
    ball = D.Ball(2.0, dimension)
    scores = jnp.asarray(np.random.default_rng(0).normal(size=(20_000, dimension)))
    points = ball.of_scores(scores)
    share = np.linalg.norm(points, axis=1) / 2.0
    length = np.linalg.norm(scores, axis=1)
    np.testing.assert_allclose(share**dimension, scipy.stats.chi(dimension).cdf(length), atol=1e-12)
    near = length < 5
    np.testing.assert_allclose(ball.scores(points)[near], scores[near], atol=1e-7)
    power = 0.5 * (dimension + 1)
    marginal, at = ball.marginals()[0], jnp.linspace(0.01, 0.99, 9)
    exact = scipy.stats.beta(power, power, -2, 4)
    np.testing.assert_allclose(marginal.quantile(at), exact.ppf(at), atol=1e-12)
    np.testing.assert_allclose(marginal.deviation(), exact.std(), rtol=1e-12)
    middle = jax.jacfwd(ball.of_scores)(jnp.zeros(dimension))
    beside = ball.of_scores(jnp.full(dimension, 1e-5)) / 1e-5
    np.testing.assert_allclose(np.diag(middle), beside, rtol=1e-6)
    back = jax.jacfwd(ball.scores)(jnp.zeros(dimension))
    np.testing.assert_allclose(middle @ back, np.eye(dimension), atol=1e-12)


def test_a_sample_has_the_spread_of_the_disc_and_a_budget_one_row():
    study = jc.monte_carlo(problem(), 2048)
    found = study.standard_deviation("error")
    assert abs(found.value - np.sqrt(PIN + GAP)) < found.error < 3e-8
    budget = study.error_budget("error")
    assert list(budget) == ["pin", "gap", "remainder (not linear)"]
    np.testing.assert_allclose([budget["pin"].value, budget["gap"].value], [PIN, GAP], rtol=2e-3)
    assert {"pin x", "pin y", "gap"} <= set(study.to_dataset().data_vars)
    assert "pin 0, 0 m" in str(study.problem)


def test_shares_of_a_variance_are_those_of_groups():
    """x y over a disc has the variance R^4 / 24: no first-order share of x or y by itself."""
    product = problem(lambda pin, gap: pin[0] * pin[1] / R + 0.5 * gap)
    found, surface = jc.sobol_indices(product, 256), jc.sobol_indices(jc.surface(product, 128))
    shapley = jc.shapley_effects(product, 2048).effects
    parts = {"pin": R**2 / 24, "gap": 0.25 * SPREAD**2}
    for name, part in parts.items():
        exact, key = part / sum(parts.values()), ("response", name)
        for own in (found, surface):
            for share in (own.first[key], own.total[key]):
                assert abs(share.value - exact) < max(share.error, 1e-6) < 0.03
        assert abs(shapley[key].value - exact) < 2 * shapley[key].error < 0.2
    assert list(found.table().index.get_level_values("variable")) == ["pin", "gap"]


def test_the_worst_case_is_that_of_the_disc_and_not_of_its_box():
    found = jc.worst_case(problem(), sigmas=2.0)
    exact = R * np.hypot(*SLOPE) + 4.0 * SPREAD
    assert "within the tolerances" in found.sentence() and "box" not in found.sentence()
    for end, sign in ((found.largest, 1), (found.least, -1)):
        np.testing.assert_allclose(end["error"].value, sign * exact, rtol=1e-9)
        np.testing.assert_allclose(end["error"].first_order, sign * exact, rtol=1e-9)
        assert np.hypot(*end["error"].values[:2]) <= R * (1 + 1e-12)


def test_the_worst_case_of_a_bent_response_over_two_discs_is_slsqps():
    bent = lambda p, q: jnp.hypot(1.0 + p[0] - q[0], 0.02 + 3.0 * p[1] - q[1]) + 40.0 * p[0] * q[1]
    sizes = {"p": 0.03, "q": 0.02}
    own = {name: jc.Dimension((0.0, 0.0), D.Ball(size)) for name, size in sizes.items()}
    found = jc.worst_case(jc.FunctionProblem(bent, own))
    within = lambda i, r: {"type": "ineq", "fun": lambda v: r**2 - v[i] ** 2 - v[i + 1] ** 2}
    how = {"method": "SLSQP", "tol": 1e-14, "constraints": [within(0, 0.03), within(2, 0.02)]}
    starts = np.random.default_rng(0).normal(size=(12, 4)) * 0.01
    for end, sign in ((found.largest, -1), (found.least, 1)):
        of = lambda v, sign=sign: sign * float(bent(v[:2], v[2:]))
        best = min(scipy.optimize.minimize(of, v, **how).fun for v in starts)
        assert end["response"].value == pytest.approx(sign * best, abs=1e-9)


def test_the_half_width_of_one_coordinate_is_half_of_the_radius():
    """The mean of x^2 + y^2 over an ellipse of half axes a, b: (a^2 + b^2) / 4, by one a / 2."""
    square = problem(lambda pin, gap: (pin[0] ** 2 + pin[1] ** 2) * 1e6)
    by_axis = jc.sensitivity(square, "half width of pin x", sample=jc.monte_carlo(square, 512))
    (slope,) = by_axis.derivatives.values()
    assert slope.value == pytest.approx(0.5e6 * R, rel=0.1)


def test_a_rare_shift_has_the_probability_of_its_segment():
    """Of a disc the part beyond a chord at h: (arccos h - h sqrt(1 - h^2)) / pi."""
    only = jc.FunctionProblem(
        lambda pin: {"error": SLOPE[0] * pin[0] + SLOPE[1] * pin[1]},
        {"pin": jc.Dimension((0.0, 0.0), D.Ball(R))},
    )
    limit = 0.97 * R * np.hypot(*SLOPE)
    found = jc.reliability(only, jc.limit_state.Above("error", limit))
    exact = (np.arccos(0.97) - 0.97 * np.sqrt(1 - 0.97**2)) / np.pi
    low, high = found.interval
    assert low <= exact <= high < 1.5 * low
    assert list(found.importance()) == ["pin"]


def test_numbers_of_a_variable_belong_together(tmp_path):
    """Screening moves them together, a folder keeps which they are."""
    found = jc.screening(problem(), 8)
    assert set(found.mu_star) == {("error", "pin"), ("error", "gap")} and found.runs == 8 * 3
    jc.campaign(problem(), 64, folder=tmp_path / "kept")
    found = jc.open_campaign(tmp_path / "kept")
    assert list(found.error_budget("error"))[:2] == ["pin", "gap"]
    assert found.problem.names == ("pin x", "pin y", "gap")


def test_a_place_of_a_mechanism_varies_in_a_disc():
    """Slope of the slide by the pin's place times R / 2, to first order (closed form)."""
    rig, angle, crank, rod = jc.scenes.slider_crank("ideal"), 0.7, 0.05, 0.12
    pin = jc.Variable(lambda m: m.connections["A"].parent.at, D.Ball(R))
    slide = {"slide": jc.response.FromFunction(lambda s: s.body("slider").com[0, 0], "m")}
    asked = jc.PositionProblem(rig, slide, {"pin": pin}, positions={"O": [angle]})
    assert asked.names == ("pin x", "pin y") and asked.variable_units == ("m", "m")
    study = jc.monte_carlo(asked, 256)
    y, turn = crank * np.sin(angle), np.array([np.cos(angle), -np.sin(angle)])
    slope = turn - y / np.sqrt(rod**2 - y**2) * np.array([np.sin(angle), np.cos(angle)])
    found = study.standard_deviation("slide")
    exact = R / 2 * np.linalg.norm(slope)
    assert abs(found.value - exact) < found.error < 0.02 * exact
    slopes = jc.sensitivity(asked, sample=study).derivatives
    for (_, name), told in slopes.items():
        exact = slope["xy".index(name[-1])]
        assert told.value == pytest.approx(exact, rel=1e-3)


def test_rectangles_are_two_independent_numbers():
    box = D.Independent(("x", "y"), (D.Uniform(2.0), D.Normal(1.0)))
    of = lambda at: {"sum": at[0] + at[1]}
    asked = jc.FunctionProblem(of, {"at": jc.Dimension((1.0, 0.0), box)})
    found = jc.worst_case(asked, sigmas=2.0)
    assert found.largest["sum"].value == pytest.approx(1.0 + 2.0 + 2.0, rel=1e-8)
    study = jc.monte_carlo(asked, 1024).standard_deviation("sum")
    assert study.value == pytest.approx(np.sqrt(4 / 3 + 1), rel=1e-3)


test_what_several_numbers_cannot_be_is_said = refusals(
    {
        'take a derivative by each: "pin x"': lambda: jc.sensitivity(problem(), "pin"),
        "only variables of one number": lambda: problem(correlation={("pin", "gap"): 0.5}),
        "one nominal value, and its distribution": lambda: jc.Dimension(0.0, D.Ball(R)),
        "it must be 2": lambda: D.Ball(R, 4),
        "give each number a name": lambda: D.Independent(("x",), (D.Ball(R),)),
        "points at 1 numbers": lambda: jc.PositionProblem(
            jc.scenes.slider_crank("ideal"),
            {"slide": lambda s: s.body("slider").com[0, 0]},
            {"pin": jc.Variable(lambda m: m.bodies["rod"].mass, D.Ball(R))},
            positions={"O": [0.7]},
        ),
        '"a x" is a variable and a part of one': lambda: jc.FunctionProblem(
            lambda **own: 0.0 * own["a"][0] + own["a x"],
            {"a": jc.Dimension((0.0, 0.0), D.Ball(R)), "a x": jc.Dimension(0.0, D.Normal(1.0))},
        ),
    }
)
