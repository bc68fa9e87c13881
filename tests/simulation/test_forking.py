"""A forked child ends in a sentence where it would wait for ever; a spawned one computes."""

import os
import subprocess
import sys

import pytest

from tests.rigs.cells import slow

PROGRAM = """
import multiprocessing, sys, warnings
import jax
import jaxclear as jc

def run(_):
    try:
        step = jc.integrator.FixedStep(1e-5)
        jc.simulate(jc.scenes.slider_crank(wear=False), 1e-4, save=3, integrator=step)
    except RuntimeError as sentence:
        return str(sentence)
    return "ran"

if __name__ == "__main__":
    warnings.simplefilter("ignore")
    if sys.argv[2] == "after":
        jax.numpy.ones(3).block_until_ready()
    with multiprocessing.get_context(sys.argv[1]).Pool(1) as pool:
        print(pool.map(run, [0])[0])
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
@pytest.mark.parametrize(
    ("way", "when", "said"),
    [
        ("fork", "after", "this process was forked from one in which JAX had begun to compute"),
        *slow(("fork", "before", "ran"), ("forkserver", "after", "ran"), ("spawn", "after", "ran")),
    ],
)
def test_a_process_says_that_it_was_forked(way, when, said, tmp_path):
    script = tmp_path / "program.py"
    script.write_text(PROGRAM)
    done = subprocess.run(
        [sys.executable, str(script), way, when], capture_output=True, text=True, timeout=120
    )
    assert done.stdout.startswith(said), done.stderr[-2000:]
