"""What a run found at its beginning is found again by the next run of the same numbers, and by no
other."""

import copy
import gc
import pickle

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.ground.recent_results import Latest
from jaxclear.multibody import assembly
from jaxclear.simulation import simulate as module

INTEGRATOR = jc.integrator.FixedStep(2e-5)


def run(rig, duration=1e-3, **how):
    return jc.simulate(rig, duration, integrator=INTEGRATOR, save=3, verify=False, **how)


@pytest.fixture
def searches(monkeypatch):
    """How often a start was looked for."""
    found, own = [], assembly.first_search
    monkeypatch.setattr(assembly, "first_search", lambda *asked: found.append(1) or own(*asked))
    return found


def slider(clearance):
    rig = jc.scenes.slider_crank()
    return eqx.tree_at(lambda r: r.connections["B"].joint.clearance, rig, jnp.asarray(clearance))


def test_the_same_numbers_begin_alike(searches):
    first, again = run(slider(1.2345e-4)), run(slider(1.2345e-4))
    assert len(searches) == 1
    for one, other in zip(jax.tree.leaves(first), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(one, other)
    assert run(slider(1.2345e-4), 2e-3).succeeded and len(searches) == 1


def test_other_numbers_are_assembled(searches):
    lengths = [run(slider(x)).mechanism.connections["B"].joint.clearance for x in (2.1e-4, 2.2e-4)]
    assert len(searches) == 2 and lengths == [2.1e-4, 2.2e-4]


def test_the_same_arrays_are_looked_at_once(monkeypatch):
    """JAX's never change; a number of NumPy's that is put in place may."""
    looks, with_quantities = [], module.with_quantities
    monkeypatch.setattr(
        module, "with_quantities", lambda pair: looks.append(pair) or with_quantities(pair)
    )
    of_run = lambda rig, *how: float(run(rig, *how).mechanism.connections["B"].joint.clearance)
    rig = slider(2.5e-4)
    assert [of_run(rig), of_run(rig, 2e-3), len(looks)] == [2.5e-4, 2.5e-4, 1]
    number = np.array(2.6e-4)
    rig = eqx.tree_at(lambda r: r.connections["B"].joint.clearance, rig, number)
    assert of_run(rig) == 2.6e-4
    number[()] = 2.7e-4
    assert of_run(rig) == 2.7e-4


def test_what_warns_warns_each_time():
    rig = slider(2.3e-4)
    for _ in range(2):
        with pytest.warns(UserWarning, match="longer steps than the shortest saving interval"):
            jc.simulate(rig, 1e-4, integrator=INTEGRATOR, save=31, verify=False)


def test_what_is_refused_is_refused_each_time():
    rig = jc.scenes.guide()
    for _ in range(2):
        with pytest.raises(ValueError, match="set-valued friction"):
            run(rig)


def test_arguments_among_results_are_jaxs(searches):
    """Also where they are NumPy's, as saving times are."""
    found = run(slider(2.4e-4))
    assert all(isinstance(x, jax.Array) for x in jax.tree.leaves(eqx.filter(found, eqx.is_array)))


def test_runs_of_other_numbers_keep_no_memory(monkeypatch, young_garbage):
    """Equinox keeps what is copied or unpickled for ever, where its own `__new__` makes it."""
    counted = lambda: sum(type(each) in (jc.Mechanism, jc.Trajectory) for each in gc.get_objects())
    # Of 16 beginnings, and mechanisms, that stay at hand.
    monkeypatch.setattr(module, "_INITIAL", Latest(2))
    monkeypatch.setattr(module, "_KEYS", Latest(2))
    it = copy.copy(slider(3e-4)), pickle.loads(pickle.dumps(slider(3e-4)))
    assert all(one.connections["B"].joint.clearance == 3e-4 for one in it)

    def run_often():
        for i in range(2):
            run(slider(3.1e-4 + 1e-9 * i))
            copy.copy(run(slider(3e-4)))
            pickle.loads(pickle.dumps(slider(3e-4)))
        gc.collect()
        return counted()

    # By the second time what else stays at hand is full.
    _, before, after = [run_often() for _ in range(3)]
    assert after <= before


def test_the_last_answer_stays_however_large():
    kept = Latest(2.0)
    for key, size in (("a", 1.0), ("b", 1.0), ("c", 5.0)):
        kept.keep(key, key, size)
    assert [kept.get(key) for key in "abc"] == [None, None, "c"]
