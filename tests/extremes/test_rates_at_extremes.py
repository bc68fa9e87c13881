"""Value and derivatives of the state's rate are finite wherever a mechanism can get, for every
clearance joint."""

from functools import cache

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from jax.flatten_util import ravel_pytree

from jaxclear.native.compiled import compiled_quickly
from tests.rigs.cells import slow
from tests.rigs.clearance_joints import JOINTS, USUAL, layout, pose, rate


def decades(low, high):
    return st.floats(low, high).map(lambda exponent: 10.0**exponent)


PARAMETERS = st.fixed_dictionaries(
    {
        "clearance": decades(-9, -2),
        "stiffness": decades(5, 13),
        "mu": st.one_of(st.just(0.0), st.floats(0.0, 2.0)),
        "transition_speed": decades(-9, 0),
        "light_mass": st.sampled_from([1e-6, 1e-3, 1.0, 1e3]),
        "worn_depth": st.sampled_from([0.0, 1e-9, 1e-5]),
    }
)
ANGLES = st.one_of(st.sampled_from([0.0, np.pi / 2, np.pi, -np.pi / 2]), st.floats(-np.pi, np.pi))
SPEEDS = st.one_of(st.just(0.0), decades(-6, 3), decades(-6, 3).map(lambda x: -x))
# Share of the clearance: concentric, all but concentric, open, exact touch and its neighbours,
# pressed.
SHARES = st.one_of(
    st.sampled_from(
        [0.0, 1e-300, 1e-160, 1e-100, 1e-12, 0.5, 1.0 - 1e-15, 1.0, 1.0 + 1e-15, 1.0 + 1e-6, 1.5]
    ),
    st.floats(0, 2),
)
SITUATIONS = st.fixed_dictionaries(
    {
        "share": SHARES,
        "direction": ANGLES,
        "height": st.sampled_from([0.0, 1.0, -1.0, 2.0]),
        "tilt": st.one_of(st.just(0.0), decades(-12, -1)),
        "tilt_direction": ANGLES,
        "turn": ANGLES,
        "hinge": ANGLES,
        "speeds": st.lists(SPEEDS, min_size=7, max_size=7),
        "memory": st.sampled_from([0.0, 1e-9, 0.1]),
    }
)
AT_REST = {
    "share": 0.0,
    "direction": 0.0,
    "height": 0.0,
    "tilt": 0.0,
    "tilt_direction": 0.0,
    "turn": 0.0,
    "hinge": 0.0,
    "speeds": [0.0] * 7,
    "memory": 0.0,
}


def state_of(kind, p, situation):
    where = {name: situation[name] for name in ("direction", "tilt", "tilt_direction", "turn")}
    heavy = pose(
        kind,
        eccentricity=situation["share"] * p["clearance"],
        height=situation["height"] * p["clearance"],
        **where,
    )
    plan = layout(kind)
    speeds = np.array(situation["speeds"])[: plan.speeds]
    # metres a second beside radians a second: at the journal's surface both mean about the same
    linear = plan.speeds - 1 - (1 if kind.startswith("planar") else 3)
    speeds[:linear] *= 1e-2
    rest = np.zeros(plan.size - plan.memory_start)
    memories = sum(
        remembers + bristles for _, kinds in plan.memories for remembers, bristles in kinds
    )
    rest[:memories] = situation["memory"]
    return np.concatenate([heavy, [situation["hinge"]], speeds, rest])


@cache
def compiled(kind):
    """Value, forward and reverse derivative by every parameter and every entry of the state."""

    def everything(p, state):
        def function(p, state):
            return rate(kind, p, state)

        inputs, restore = ravel_pytree((p, state))
        # one direction at a time: a batch of directions takes twenty times as long to compile
        forward = jax.lax.map(
            lambda e: jax.jvp(lambda x: function(*restore(x)), (inputs,), (e,))[1],
            jnp.eye(inputs.size),
        )
        value, pull = jax.vjp(function, p, state)
        # unequal weights: what is not a number in one row cannot cancel in the sum over rows
        return value, forward, pull(1.0 + jnp.arange(value.shape[0]))

    # Not optimised: compiled in two thirds of the time, and as fast. Numbers of Python would be
    # constants of the program.
    compiled = compiled_quickly(everything)
    return lambda *given: compiled(*jax.tree.map(jnp.asarray, given))


def assert_finite(tree, words):
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        assert np.all(np.isfinite(leaf)), f"{words}{jax.tree_util.keystr(path)}: {leaf}"


# Second derivatives take long to compile: joints whose parts others have as well go with the long
# tests.
LONG = {
    "guide",
    "journal",
    "journal_that_wears",
    "journal_with_collars",
    "ball",
    "ball_with_bristles",
    "planar_conformal",
}


@pytest.mark.parametrize("kind", [slow(k)[0] if k in LONG else k for k in JOINTS])
def test_rate_and_derivatives_are_finite(kind):
    evaluate = compiled(kind)

    @settings(max_examples=150)
    @example(USUAL, AT_REST)
    @example(USUAL | {"worn_depth": 0.0, "mu": 0.0}, AT_REST)
    @example(USUAL, AT_REST | {"share": 1.0})
    @example(USUAL, AT_REST | {"share": 1.1})
    @example(USUAL, AT_REST | {"share": 1.1, "tilt": 1e-2})
    @example(
        USUAL | {"clearance": 1e-9, "stiffness": 1e13},
        AT_REST | {"share": 2.0, "speeds": [1e3] * 7},
    )
    @given(PARAMETERS, SITUATIONS)
    def check(p, situation):
        value, forward, backward = evaluate(p, state_of(kind, p, situation))
        assert_finite(value, "rate")
        assert_finite(forward, "forward derivative")
        assert_finite(backward, "reverse derivative")

    check()
