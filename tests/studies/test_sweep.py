"""Responses over a grid of variables: each point is the problem's own answer, and one that fails is
named."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc

D = jc.distribution


def root(a, b, c):
    return {"sum": a + 10 * b, "root": jnp.sqrt(a - b) + c}


PROBLEM = jc.FunctionProblem(
    root,
    {
        n: jc.Dimension(x, D.Normal(0.1), unit="mm")
        for n, x in {"a": 1.0, "b": 0.5, "c": 3.0}.items()
    },
    units={"sum": "mm", "root": "mm"},
)
A, B = np.array([1.0, 2.0, 4.0]), np.array([0.0, 1.0])


@pytest.fixture(scope="module")
def grid():
    return jc.sweep(PROBLEM, {"b": B, "a": A})


def test_every_point_of_the_grid_is_the_problems_own(grid):
    np.testing.assert_allclose(grid.responses["sum"], A + 10 * B[:, None], rtol=1e-15)
    expected = np.sqrt(A - B[:, None]) + 3.0
    np.testing.assert_allclose(grid.responses["root"], expected, rtol=1e-15)
    assert not grid.failures() and not grid.warnings
    assert '"sum" lies between 1 and 14 mm over the grid.' in grid.sentence()


def test_a_sweep_is_data_with_units(grid):
    data = grid.to_dataset()
    assert data["root"].dims == ("b", "a") and data["a"].attrs["units"] == "mm"
    assert float(data["sum"].sel(b=1.0, a=4.0)) == 14.0
    assert grid.table().loc[(1.0, 4.0), "sum"] == 14.0
    assert "sum [mm]" in str(grid)


def test_a_point_that_fails_is_named_and_the_others_go_on():
    found = jc.sweep(PROBLEM, {"a": [0.0, 1.0]})
    assert list(found.failures()) == [(0,)] and "not finite" in found.failures()[0,]
    assert np.isnan(found.responses["root"][0]) and np.isfinite(found.responses["root"][1])
    assert "1 of 2 points failed; the first of them, a 0 mm: a number that" in str(found)


def test_a_mechanism_is_swept_by_one_program():
    rig = jc.scenes.slider_crank()
    problem = jc.Problem(
        rig,
        {"speed": lambda run: run.body("slider").velocity[-1, 0]},
        {"clearance": jc.Variable(lambda r: r.connections["B"].joint.clearance, tolerance=2e-5)},
        duration=2e-3,
        save=3,
    )
    sizes = np.linspace(1e-4, 3e-4, 3)
    found = jc.sweep(problem, {"clearance": sizes}).responses["speed"]
    one = jax.jit(problem.evaluate)
    alone = [float(one(jnp.array([c])).responses["speed"]) for c in sizes]
    np.testing.assert_allclose(found, alone, rtol=1e-9)


MISTAKES = {
    'no variable "d"': {"d": [1.0]},
    "over of sweep is empty": {},
    'values of "a" in sweep .* a row of finite numbers': {"a": [1.0, np.nan]},
    'values of "a" in sweep are .wide': {"a": "wide"},
    "a row of finite numbers": {"a": 1.0},
    "over of sweep": ["a"],
}


@pytest.mark.parametrize("sentence", MISTAKES)
def test_mistakes_get_a_sentence(sentence):
    with pytest.raises(ValueError, match=sentence):
        jc.sweep(PROBLEM, MISTAKES[sentence])
