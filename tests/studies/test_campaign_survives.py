"""Campaigns whose processes are killed: the folder ends as if nothing had happened, bit for bit."""

import multiprocessing
import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.studies.store import workers as dask_workers
from jaxclear.studies.store.store import CHUNKS, Store
from tests.rigs.wearing_ring import problem as one_turn
from tests.rigs.wearing_ring import wearing_ring
from tests.studies.test_campaign import contents, problem

pytestmark = pytest.mark.slow

CHUNK, COUNT = 4096, 300
SAMPLES_ASKED = CHUNK * COUNT - 1000


def run(folder, samples=SAMPLES_ASKED):
    return jc.campaign(problem(), samples, folder=folder, seed=5, chunk=CHUNK)


def run_slowly(folder):
    """As `run`, with a pause before every file: the end comes between any two of them."""
    put = Store._put

    def slowly(*own):
        time.sleep(4e-2)
        put(*own)

    Store._put = slowly
    run(folder)


def marks(folder):
    """Chunks that are finished."""
    place = folder / CHUNKS
    return len(list(place.iterdir())) if place.exists() else 0


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    place = tmp_path_factory.mktemp("whole") / "kept"
    run(place)
    return place


def test_killed_twenty_times_and_resumed_is_the_same_bit_for_bit(whole, tmp_path):
    """Each process is killed (SIGKILL) some chunks and some moments after it began."""
    place = tmp_path / "kept"
    chance = random.Random(1)
    processes = multiprocessing.get_context("forkserver")
    processes.set_forkserver_preload(["jaxclear", "tests.studies.test_campaign"])
    alive = 0
    for _ in range(20):
        before, one = marks(place), processes.Process(target=run_slowly, args=(place,))
        one.start()
        wanted = before + chance.randint(0, 8)
        while marks(place) < wanted and one.is_alive():
            time.sleep(1e-3)
        time.sleep(chance.uniform(0, 0.02))
        alive += one.is_alive()
        os.kill(one.pid, signal.SIGKILL)
        one.join()
        assert marks(place) >= before
    assert alive == 20 and 20 < marks(place) < COUNT
    run(place)
    assert contents(place) == contents(whole)


def test_processes_at_one_folder_share_its_chunks(whole, tmp_path):
    """Two work side by side, one of them is killed; the other one finishes."""
    place = tmp_path / "kept"
    processes = multiprocessing.get_context("forkserver")
    processes.set_forkserver_preload(["jaxclear", "tests.studies.test_campaign"])
    both = [processes.Process(target=run_slowly, args=(place,)) for _ in range(2)]
    for one in both:
        one.start()
    while marks(place) < 40:
        time.sleep(1e-3)
    os.kill(both[0].pid, signal.SIGKILL)
    both[1].join()
    assert both[1].exitcode == 0
    assert contents(place) == contents(whole)


def traced(bore, pin):
    """Leaves a line for every time that it is traced."""
    with open(os.environ["TRACES"], "a") as told:
        told.write(f"{os.getpid()}\n")
    return {"fit": jnp.sqrt(bore - pin), "area": bore**2 - pin**2}


def test_a_lost_worker_costs_no_sample(tmp_path, monkeypatch):
    """Dask on two processes, one of them killed in the middle; every worker compiles once."""
    distributed = pytest.importorskip("distributed")
    monkeypatch.setenv("TRACES", str(tmp_path / "traces"))
    asked, samples = problem(function=traced), 200 * CHUNK
    jc.campaign(asked, samples, folder=tmp_path / "here", seed=5, chunk=CHUNK)
    (tmp_path / "traces").unlink()
    place = tmp_path / "there"
    cluster = distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
    with cluster, distributed.Client(cluster) as client:
        pids = client.run(os.getpid)
        client.run(os.environ.update, TRACES=str(tmp_path / "traces"))
        killed = []

        def kill():
            while marks(place) < 40:
                time.sleep(1e-3)
            begun = (tmp_path / "traces").read_text().split()
            killed.append(next(pid for pid in pids.values() if str(pid) in begun))
            os.kill(killed[0], signal.SIGKILL)

        killer = threading.Thread(target=kill)
        killer.start()
        found = jc.campaign(asked, samples, folder=place, seed=5, chunk=CHUNK, client=client)
        killer.join()
    assert found.is_complete
    assert contents(place) == contents(tmp_path / "here")
    lines = (tmp_path / "traces").read_text().split()
    own = {pid: lines.count(pid) for pid in set(lines) - {str(os.getpid())}}
    assert str(killed[0]) in own
    assert set(own.values()) == {1}, own


def test_a_cluster_whose_workers_have_not_joined_is_waited_for(tmp_path, monkeypatch):
    """Until the first is there; where none comes, a sentence says so."""
    distributed = pytest.importorskip("distributed")
    how = {"n_workers": 0, "threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(**how) as cluster, distributed.Client(cluster) as client:
        with monkeypatch.context() as patched:
            patched.setattr(dask_workers, "JOINING", 0.1)
            with pytest.raises(RuntimeError, match="no worker has joined"):
                jc.campaign(problem(), 100, folder=tmp_path, client=client)
        threading.Timer(0.5, cluster.scale, (1,)).start()
        assert jc.campaign(problem(), 100, folder=tmp_path, client=client).is_complete


@pytest.mark.usefixtures("optimised_kernels")
def test_a_mechanism_travels_to_workers(tmp_path):
    distributed = pytest.importorskip("distributed")
    asked = one_turn(wearing_ring())
    cluster = distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
    with cluster, distributed.Client(cluster) as client:
        found = jc.campaign(asked, 96, folder=tmp_path / "there", client=client)
    plain = jc.monte_carlo(asked, 96, chunk=64)
    for name, own in plain.responses.items():
        assert np.array_equal(own, found.responses[name], equal_nan=True)
    assert found.warnings() == plain.warnings()
    assert found.sentence() == plain.sentence()


ON_TWO = """
import sys

import jax
import jaxclear as jc
from tests.studies.test_campaign_survives import CHUNK, problem

assert jax.local_device_count() == 2
jc.campaign(problem(), 5 * CHUNK - 3, folder=sys.argv[1], seed=5, chunk=2 * CHUNK)
"""


def test_two_devices_share_a_chunk_and_give_the_same_numbers(tmp_path):
    """The processor posing as two devices."""
    flags = {"XLA_FLAGS": "--xla_force_host_platform_device_count=2"}
    said = [sys.executable, "-c", ON_TWO, str(tmp_path / "two")]
    subprocess.run(said, check=True, env=os.environ | flags, cwd=Path(__file__).parents[2])
    two = jc.open_campaign(tmp_path / "two")
    assert two.plan.chunk == 2 * CHUNK
    one = jc.monte_carlo(problem(), 5 * CHUNK - 3, seed=5)
    assert np.array_equal(two.values, one.values)
    for name, own in one.responses.items():
        assert np.array_equal(own, two.responses[name], equal_nan=True)
