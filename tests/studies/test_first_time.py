"""What a study takes for the first time in a process: few programs, and none that another process
has left."""

import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.ground import cache_folder
from jaxclear.native import compiled
from jaxclear.studies import run_experiment
from jaxclear.studies.store.batch import LANES, chunk_size, evaluate_all

PROGRAM = """
import json
import jax
import jaxclear as jc
built = []
jax.monitoring.register_event_duration_secs_listener(
    lambda name, *_, **told: built.append(told["fun_name"]) if "backend_compile" in name else None
)
problem = jc.Problem(
    jc.scenes.slider_crank(),
    jc.response.MeanContactForce("B"),
    {"clearance": jc.Variable(lambda rig: rig.connections["B"].joint.clearance, tolerance=20e-6)},
    duration=0.01,
)
before = len(built)
sample = jc.monte_carlo(problem, 128)
found = jc.sensitivity(problem, "clearance", sample=sample)
built_of_study = built[before:]
jc.simulate(jc.scenes.slider_crank(), 0.01, save=11).contact("B")
print(json.dumps([str(sample.values.tolist()) + str(found), built_of_study, before, built]))
"""


def in_another_process(folder):
    root = Path(jc.__file__).parents[1]
    environment = os.environ | {cache_folder.VARIABLE: str(folder), "PYTHONPATH": str(root)}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.slow
def test_a_second_process_finds_the_programs_of_a_study(tmp_path):
    """Although a user's function says what varies; its numbers are the same."""
    (first, built, *_), (second, again, made, every) = (
        in_another_process(tmp_path) for _ in range(2)
    )
    assert first == second
    # What is read of a run is as quick.
    assert "jit(_contact_columns)" not in every
    # Of what the problem itself asks there were 45, a second and a half to compile.
    assert made <= 6
    # Before distributions were evaluated without JAX they were 120.
    assert "jit(_of_chunk)" in built and len(built) <= 15
    assert len(again) <= 5 and not {"jit(_of_chunk)", "jit(_weights)"} & set(again)


def test_few_samples_cost_what_their_chunk_does(monkeypatch):
    """Few samples share one program."""
    clearance = jc.Variable(lambda rig: rig.connections["B"].joint.clearance, tolerance=1e-6)
    problem = jc.Problem(
        jc.scenes.slider_crank(),
        jc.response.MeanContactForce("B"),
        {"clearance": clearance},
        duration=1e-3,
        integrator=jc.integrator.FixedStep(1e-4),
        save=3,
    )
    values = np.asarray(problem.nominal())[None]
    form = jax.tree.structure(problem)
    assert problem.description is problem.description
    # What is known of a problem is no part of the form by which its programs are found.
    assert jax.tree.structure(problem) == form
    expected = evaluate_all(problem, values)
    assert {chunk_size(problem, count) for count in (1, 2, LANES)} == {LANES}
    prepared = []
    prepare = run_experiment.prepare
    monkeypatch.setattr(run_experiment, "prepare", lambda *a: prepared.append(a) or prepare(*a))
    result = evaluate_all(problem, values)
    assert prepared == []
    assert np.array_equal(*(own.responses["response"] for own in (expected, result)))


def test_chunks_of_long_runs_are_few_samples():
    """Each has thousands of saved states, so a call costs nothing beside its runs: more samples
    took memory, and a program for each number of them."""
    problem = jc.Problem(
        jc.scenes.slider_crank(),
        jc.response.MeanContactForce("B"),
        {
            "clearance": jc.Variable(
                lambda rig: rig.connections["B"].joint.clearance, tolerance=1e-6
            )
        },
        duration=1.0,
        integrator=jc.integrator.FixedStep(1e-4),
        save=10_001,
    )
    assert 2 * LANES * problem.cost().memory > run_experiment.NEAR_A_CORE
    assert {chunk_size(problem, count) for count in (1, 16, 64, 10_000)} == {LANES}


def test_what_is_read_of_a_run_is_of_the_programs_that_processes_share(tmp_path, monkeypatch):
    """Its numbers are those of a program of JAX's."""
    run = jc.simulate(jc.scenes.slider_crank(), 1e-3, save=13, verify=False)
    monkeypatch.setenv(cache_folder.VARIABLE, str(tmp_path))
    force, place = run.contact("B").normal_force, run.body("slider").com
    shared = {function.__name__ for function, *_ in compiled._AT_HAND.entries}
    assert {"_contact_columns", "_body_columns"} <= shared
    monkeypatch.setenv(cache_folder.VARIABLE, "0")
    assert np.allclose(force, run.contact("B").normal_force, rtol=1e-12, atol=0)
    assert np.allclose(place, run.body("slider").com, rtol=1e-12, atol=1e-15)
