"""Ctrl-C is answered within a second and leaves the machine idle; nothing that was stopped looks
like an answer."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear  # noqa: F401  (float64)
from jaxclear.native import stop, stoppable, while_loop
from jaxclear.native.stopping import FLAG
from tests.rigs.cells import slow

# What runs is started warm; then Ctrl-C comes from outside, as from a terminal.
PROGRAM = """
import os, signal, sys, time
import jaxclear as jc

# A shell's background job is born deaf to Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)

rig = jc.scenes.slider_crank(wear=False)
step = jc.integrator.FixedStep(1e-6)

varied = {"c": jc.Variable(lambda r: r.connections["B"].joint.clearance, tolerance=1e-6)}
last = lambda r: r.states[-1, 0]

# The same functions, so that the second problem is compiled with the first.
def problem(duration):
    return jc.Problem(rig, last, varied, duration=duration, integrator=step, save=3)

go = {
    "simulate": lambda duration: jc.simulate(rig, duration, save=3, integrator=step),
    "monte_carlo": lambda duration: jc.monte_carlo(problems[duration], 64, chunk=8),
}[sys.argv[1]]
# Built before: a problem assembles its mechanism, and compiling is not interrupted.
problems = {duration: problem(duration) for duration in (1e-5, 300.0)}
go(1e-5)
print("begins", flush=True)
try:
    go(300.0)
    print("finished", flush=True)
except KeyboardInterrupt:
    print("interrupted", time.time(), flush=True)
    used = time.process_time()
    time.sleep(0.5)
    print("idle" if time.process_time() - used < 0.1 else "busy", flush=True)
    go(1e-5)
    print("runs again", flush=True)
"""


def answered(study):
    """Seconds until Ctrl-C is answered, and what is said after it."""
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, study], stdout=subprocess.PIPE, text=True
    )
    # Who is never answered fails, and does not wait.
    patience = threading.Timer(300, process.kill)
    patience.start()
    try:
        assert process.stdout.readline() == "begins\n"
        time.sleep(0.5)
        asked = time.time()
        process.send_signal(signal.SIGINT)
        said, when = process.stdout.readline().split()
        assert said == "interrupted"
        return float(when) - asked, process.communicate(timeout=60)[0].splitlines()
    finally:
        patience.cancel()
        process.kill()


@pytest.mark.skipif(os.name == "nt", reason="signals of a terminal")
@pytest.mark.parametrize("study", [*slow("simulate"), "monte_carlo"])
def test_ctrl_c_is_answered_at_once_and_leaves_the_machine_idle(study):
    for _ in range(3):
        waited, said = answered(study)
        assert said == ["idle", "runs again"]
        # Other work on the machine may hold an answer up, not three in a row.
        if waited < 1:
            return
    assert waited < 1


def count(limit):
    first = (jnp.zeros((), int), 0.5)
    return while_loop(lambda s: s[0] < limit, lambda s: (s[0] + 1, jnp.cos(s[1])), first)[1]


FOR_EVER = 10**15


def test_what_was_stopped_is_no_number_and_the_next_run_is_right():
    run = jax.jit(count)
    wanted = float(run(100))
    threading.Timer(0.3, stop).start()
    found = []
    with pytest.raises(KeyboardInterrupt, match="stopped"), stoppable():
        found.append(float(run(FOR_EVER)))
    assert np.isnan(found[0]) and FLAG[0] == 0
    with stoppable():
        assert float(run(100)) == wanted


def test_runs_of_other_threads_are_stopped_and_say_so():
    run, said = jax.jit(count), []

    def other():
        with pytest.raises(KeyboardInterrupt), stoppable():
            run(FOR_EVER).block_until_ready()
        said.append(True)

    thread = threading.Thread(target=other)
    thread.start()
    time.sleep(0.3)
    with pytest.raises(KeyboardInterrupt), stoppable():
        raise KeyboardInterrupt
    thread.join(10)
    assert said == [True] and FLAG[0] == 0


def test_without_a_run_a_stop_changes_nothing():
    stop()
    assert FLAG[0] == 0


def test_whoever_listened_to_signals_before_hears_them_and_listens_again():

    hears, tells = socket.socketpair()
    hears.settimeout(5)
    tells.setblocking(False)
    before = signal.set_wakeup_fd(tells.fileno())
    caught = signal.signal(signal.SIGTERM, lambda *_: None)
    try:
        with stoppable():
            os.kill(os.getpid(), signal.SIGTERM)
            assert hears.recv(1) == bytes([signal.SIGTERM])
        assert signal.set_wakeup_fd(before) == tells.fileno()
    finally:
        signal.signal(signal.SIGTERM, caught)
        signal.set_wakeup_fd(before)
