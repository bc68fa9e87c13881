"""Attributes of modules are those that Equinox gives, sooner."""

import copy
import gc
import pickle
import weakref

import equinox as eqx
import jax

import jaxclear as jc


def journal():
    return jc.scenes.slider_crank().connections["B"].joint


def test_bound_methods_are_equinoxs():
    """A pytree of the module, of the same structure and names."""
    joint = journal()
    ours = [joint.maps for _ in range(2)]
    theirs = eqx.Module.__getattribute__(joint, "maps")
    for method in ours:
        assert type(method) is type(theirs) and method.__self__ is joint
        assert vars(method) == vars(theirs) and method.__name__ == "maps"
        assert jax.tree.structure(method) == jax.tree.structure(theirs)
    assert journal().maps.__self__ is not joint


def test_bound_methods_pass_through_programs_of_users():
    traces = []

    @jax.jit
    def call(method, step):
        traces.append(step)
        return method(step).step

    for step in (1e-5, 2e-5):
        half = call(jc.integrator.FixedStep(step).with_finer_steps, 0.5)
        assert half == step / 2
    assert len(traces) == 1


def test_bound_methods_keep_no_module():
    """Those of copies and of what is unpickled neither, for which Equinox would wait."""
    step = jc.integrator.FixedStep(1e-5)
    modules = [step, copy.copy(step), pickle.loads(pickle.dumps(step))]
    living = [weakref.ref(one.requested_step.__self__) for one in modules]
    assert all(one() is not None for one in living)
    del step, modules
    gc.collect()
    assert all(one() is None for one in living)
