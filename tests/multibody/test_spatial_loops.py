"""Mechanisms of several spatial loops: what XLA compiles of their assembly is bounded, the rest is
machine code of kernels."""

import logging

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.ground.factorisation import least_change, reduce_to_rank
from jaxclear.multibody import assembly, redundancy
from jaxclear.multibody.mechanism import stabilised_as_needed
from jaxclear.native import as_kernel, rows
from jaxclear.native.rows import operations_of
from tests.rigs.spatial_loops import SPEED, double_cardan, hinge_loops


def of_numbers(function, rig, *rest):
    """The function over the numbers of a mechanism, and these."""
    numbers, form = eqx.partition(rig, eqx.is_array)
    return lambda given: jax.tree.leaves(
        eqx.filter(function(eqx.combine(given, form), *rest), eqx.is_array)
    ), numbers


def test_of_more_loops_xla_compiles_no_more(monkeypatch):
    """Written out an assembly of ten hinges and two loops took XLA 15 s to compile."""
    judged, numbers = of_numbers(assembly._find_start.__wrapped__, hinge_loops(2), True, None)
    left, short = operations_of(jax.make_jaxpr(judged)(numbers).jaxpr), rows.SHORT
    monkeypatch.setattr(rows, "SHORT", 10**9)
    judged, numbers = of_numbers(assembly._find_start.__wrapped__, hinge_loops(2), True, None)
    whole = operations_of(jax.make_jaxpr(judged)(numbers).jaxpr)
    assert left < short + 0.3 * whole and whole > 10_000


def test_kernels_assemble_as_xla(monkeypatch, caplog):
    caplog.set_level(logging.INFO, "jaxclear")
    rig = hinge_loops(1)
    monkeypatch.setattr(rows, "SHORT", 10)
    found = jc.assemble(rig)
    assert not [x for x in caplog.messages if "left to XLA" in x]
    monkeypatch.setattr(rows, "SHORT", 10**9)
    # Of another form, so that it is compiled anew.
    other = jc.assemble(hinge_loops(1, {"none": jc.load.Gravity((0.0, 0.0, 0.0))}))
    np.testing.assert_allclose(found.coordinates, other.coordinates, atol=1e-12)
    np.testing.assert_allclose(other.residuals["ball 0"], 0.0, atol=1e-12)


@pytest.mark.parametrize("count", [5, 17])
def test_row_operations_of_any_size_are_kernels(count, caplog):
    """Rows that follow from others among them; beside NumPy's least squares."""
    caplog.set_level(logging.INFO, "jaxclear")
    random = np.random.default_rng(0)
    matrix = random.normal(size=(count, count + 4))
    matrix[-1] = matrix[0] - matrix[1]
    targets = matrix @ random.normal(size=count + 4)
    scales = jnp.ones(count + 4)

    def change(matrix, targets):
        chosen = reduce_to_rank(matrix, targets, scales, count - 1)
        return least_change(matrix, targets, scales), least_change(*chosen, scales)

    whole, chosen = jax.jit(lambda *given: as_kernel(change, *given))(matrix, targets)
    wanted = np.linalg.lstsq(matrix, targets)[0]
    np.testing.assert_allclose(whole.change, wanted, atol=1e-11)
    np.testing.assert_allclose(chosen.change, wanted, atol=1e-11)
    assert whole.exact.tolist() == [True] * (count - 1) + [False] and chosen.exact.all()
    assert not [x for x in caplog.messages if "left to XLA" in x]


def test_a_start_whose_loops_are_closed_is_not_searched_again(monkeypatch):
    """Rows of double Cardan shafts beside each other depend on each other; positions that tell
    which are sought at several instants, by one program."""
    found, find = [], assembly._find_start
    monkeypatch.setattr(assembly, "_find_start", lambda *asked: found.append(1) or find(*asked))
    times = []
    for name in ("_moved", "_place_of"):
        function = getattr(redundancy, name)
        seen = lambda *asked, function=function: times.append(asked[-1]) or function(*asked)
        monkeypatch.setattr(redundancy, name, seen)
    rig = double_cardan(2)
    start, mechanism = jc.assemble(rig), assembly.ready(rig).mechanism
    assert mechanism.topology.redundancy.depend and len(found) == 2
    assert len(set(map(float, times))) > 1 and all(eqx.is_array(time) for time in times)
    # The output turns as the input does.
    outlet = [branch.name for branch in mechanism.topology.branches].index("outlet")
    np.testing.assert_allclose(
        start.speeds[mechanism.topology.branches[outlet].speeds], SPEED, rtol=1e-9
    )


def test_a_start_is_one_program_however_an_integrator_holds_loops(monkeypatch):
    """Assembled, run by steps that project and by error control: a start is the same."""
    traces, guess = [], assembly.guess
    monkeypatch.setattr(assembly, "guess", lambda *asked: traces.append(1) or guess(*asked))
    # Three: a form that no other test here has compiled.
    rig = stabilised_as_needed(double_cardan(3), False)
    start = assembly.ready(rig)
    count = len(traces)
    again = assembly.ready(stabilised_as_needed(rig, True))
    assert len(traces) == count > 0
    np.testing.assert_array_equal(start.start.coordinates, again.start.coordinates)
    assert start.mechanism.stabilisation != again.mechanism.stabilisation
