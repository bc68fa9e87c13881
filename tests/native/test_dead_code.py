"""What nobody asks for is not worked out: a loop drops what its results that are used do not depend
on, and these stay what they are, whichever they are and whatever is mapped or differentiated."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.interpreters import partial_eval as pe

import jaxclear as jc
from jaxclear.native import TableLayout, as_kernel, by_columns, loop, scan, while_loop
from jaxclear.native.derivative_rules import columns_p

PLACE = jnp.array([1.0, 0.7, 0.5])
LONG = jnp.linspace(-1.0, 1.0, 200)
ROUNDING = 1e-12


def swung(p):
    """A damped swing, its largest speed, and a sum along a long array that only that sum reads."""
    sums = p[2] * LONG

    def turn(s):
        count, x, v, largest, total = s
        v = 0.9 * v - 0.1 * jnp.sin(p[0] * x)
        largest, total = jnp.maximum(largest, p[1] * v), total + sums[count]
        return count + 1, x + 0.1 * v, v, largest, total

    first = (jnp.zeros((), int), p[2], 1.0, 0.0, 0.0)
    return while_loop(lambda s: s[0] < 40, turn, first)[1:]


def written(p):
    """A scan with a loop in its turns, whose tables begin with rows of their own, and a long array
    of the state that is changed in memory."""
    numbers = np.arange(6.0)

    def turn(state, row):
        x, largest, marks = state
        step = lambda s: (s[0] + 1, s[1] * p[0] + 0.1 * row, s[2] + p[1])
        _, x, aside = while_loop(lambda s: s[0] < 3, step, (jnp.zeros((), int), x, p[2]))
        largest = jnp.maximum(largest, aside)
        marks = marks.at[row.astype(int)].add(x)
        return (x, largest, marks), (x * p[1], (aside, largest))

    places = np.arange(6)
    kept = [TableLayout(places + 1, 7, p[0]), TableLayout(places, 6)]
    begun = p[2], jnp.zeros(()), jnp.zeros(80)
    (x, largest, marks), (table, (aside, most)) = scan(
        turn, begun, numbers, kept, (False, False, True)
    )
    return x, largest, marks[:6], table, aside, most


def called(p):
    """A function of one turn."""
    return as_kernel(lambda q: (jnp.sin(q[0]), q[1] * q[2], jnp.tanh(q[2])), p)


WAYS = {
    "values": lambda f: f(PLACE),
    "of a batch": lambda f: jax.vmap(f)(PLACE * jnp.linspace(0.9, 1.1, 5)[:, None]),
    "along one direction": lambda f: jax.jvp(f, (PLACE,), (jnp.ones(3),)),
    "slopes in a batch": lambda f: jax.vmap(jax.jacfwd(f))(
        PLACE * jnp.linspace(0.9, 1.1, 5)[:, None]
    ),
    "backwards": lambda f: jax.jacrev(f)(PLACE),
}


FAST = {
    (swung, "slopes in a batch"),
    (written, "values"),
    (called, "values"),
}


@pytest.mark.parametrize(
    ("function", "way"),
    [
        pytest.param(*pair, marks=() if pair in FAST else pytest.mark.slow)
        for pair in itertools.product((swung, written, called), WAYS)
    ],
)
def test_every_pair_of_results_is_what_it_is_among_all(function, way):
    whole = jax.jit(lambda: WAYS[way](function))()
    paired = (lambda t: tuple(zip(*t, strict=True))) if way == "along one direction" else list
    whole = paired(whole)
    for some in itertools.combinations(range(len(whole)), 2):
        of_some = lambda p, some=some: [function(p)[i] for i in some]
        found = paired(jax.jit(lambda f=of_some: WAYS[way](f))())
        for i, own in zip(some, found, strict=True):
            for each, wanted in zip(jax.tree.leaves(own), jax.tree.leaves(whole[i]), strict=True):
                np.testing.assert_allclose(each, wanted, rtol=ROUNDING, atol=ROUNDING)


def test_a_loop_carries_what_is_asked_for(built):
    jax.jit(lambda p: swung(p)[0])(PLACE)
    (program,) = built
    # Count, place and speed; of constants two numbers at most, not the long array.
    assert len(program.body.in_avals) - program.body_constants == 3
    assert all(np.size(np.empty(a.shape)) < 200 for a in program.body.in_avals)


def test_a_scan_keeps_the_tables_that_are_asked_for(built):
    jax.jit(lambda p: written(p)[3])(PLACE)
    (program,) = built
    assert len(program.tables) == 1 and not program.long
    # The number of turns, and the place.
    assert len(program.body.in_avals) - program.body_constants == 2


@pytest.mark.parametrize("function", [swung, lambda p: by_columns(swung, p)])
def test_the_rule_is_the_same_whether_jax_tells_which_inputs_are_used_or_not(function):
    """As JAX 0.12 does and 0.11 does not."""
    program = jax.make_jaxpr(function)(PLACE)
    (equation,) = (e for e in program.eqns if e.primitive in (loop.loop_p, columns_p))
    used = [True, *[False] * (len(equation.outvars) - 1)]
    rule = pe.dce_rules[equation.primitive]
    inputs, left = rule(used, equation)
    live = [True] * len(equation.invars)
    again, left_again = rule(used, live, equation)
    assert inputs == again and left.outvars == left_again.outvars
    assert len(left.outvars) < len(equation.outvars)


def test_what_is_asked_of_columns_is_what_their_loops_work_out(built):
    function = lambda p: by_columns(swung, p)
    slope = jax.jit(lambda p: jax.grad(lambda q: function(q)[0])(p))(PLACE)
    wanted = jax.grad(lambda q: swung(q)[0])(PLACE)
    np.testing.assert_allclose(slope, wanted, rtol=1e-10)
    assert all(each.shape != (200,) for each in built[0].body.in_avals)


@pytest.mark.slow
def test_a_response_pays_for_no_derivative_that_it_does_not_ask_for(built):
    """Where a damping contact is pressed hardest is followed and differentiated for the peak's
    sake: the place at the end does without."""
    contact = jc.contact.Flores(stiffness=1e9, restitution=0.8)
    bearing = jc.clearance.PlanarJournalBearing(contact, clearance=1e-3)
    rig = jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(bearing, "ground", "journal")},
        {"gravity": jc.load.Gravity((0.0, -9.81))},
        speeds={"journal": (0.0, -0.05, 0.0)},
    )
    clearance = jc.Variable(lambda m: m.connections["B"].joint.clearance, tolerance=1e-5)
    peak, place = jc.response.PeakContactForce("B"), lambda run: run.history.states[-1][1]
    together = jc.Problem(
        rig,
        {"peak": peak, "place": place},
        {"c": clearance},
        duration=0.03,
        integrator=jc.integrator.FixedStep(2e-5),
        save=4,
    )
    ask = lambda name: jax.jit(jax.jacfwd(lambda v: together.evaluate(v).responses[name]))
    sizes, slopes = {}, {}
    for name in ("peak", "place"):
        built.clear()
        slopes[name] = ask(name)(together.nominal())
        sizes[name] = max(len(each.body.in_avals) for each in built)
    assert sizes["place"] < sizes["peak"]
    both = jax.jit(jax.jacfwd(lambda v: together.evaluate(v).responses))(together.nominal())
    for name, slope in slopes.items():
        assert np.isfinite(slope).all()
        np.testing.assert_allclose(slope, both[name], rtol=1e-9)


def test_slopes_that_depend_on_no_direction_stay_as_many_as_directions():
    """What is unknown is nan, whatever moves."""

    @jax.custom_jvp
    def unknown(x):
        return x

    unknown.defjvp(lambda x, way: (x[0], jnp.full_like(way[0], jnp.nan)))

    table = lambda p: scan(lambda x, _: (x * p[0], unknown(x)), p[2], np.arange(3.0))[1]
    slopes = jax.jit(jax.jacfwd(table))(PLACE)
    assert slopes.shape == (3, 3) and np.isnan(slopes).all()
