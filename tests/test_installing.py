"""What importing jaxclear does to the process it is imported into: it loads no library before that
is needed, starts no device, and of the user's settings changes two, which its text names."""

import json
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

LOOK = """
import json, logging, os, signal, sys, threading, warnings

import jax
from jax._src import xla_bridge


def now():
    loggers = [logging.getLogger(name) for name in ("", "jax", "jaxlib", "absl")]
    return {
        "environment": dict(os.environ),
        "logging": [[log.level, len(log.handlers), log.propagate] for log in loggers],
        "jax": {name: str(value) for name, value in sorted(jax.config.values.items())},
        "warnings": len(warnings.filters),
        "signals": [str(signal.getsignal(one)) for one in (signal.SIGINT, signal.SIGTERM)],
        "threads": threading.active_count(),
        "hooks": [sys.excepthook.__name__, sys.displayhook.__name__],
    }


import diffrax

before = now()
import jaxclear

after = now()
found = {
    "changed": {one: [before[one], after[one]] for one in before if before[one] != after[one]},
    "modules": sorted(sys.modules),
    "started": xla_bridge.backends_are_initialized(),
    "said": jaxclear.__doc__,
}
print(json.dumps(found))
"""
# Libraries that many scripts do without, each a tenth of a second or more.
LATE = {
    *("dask", "distributed", "jinja2", "llvmlite", "matplotlib", "meshio", "mujoco", "numba"),
    *("optax", "pandas", "plotly", "pyvista", "scipy.interpolate", "scipy.optimize"),
    *("scipy.sparse", "scipy.spatial", "scipy.special", "scipy.stats", "xarray", "yaml", "zarr"),
}


@pytest.fixture(scope="module")
def imported():
    plain = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    done = subprocess.run(
        [sys.executable, "-c", LOOK], env=plain, capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout.splitlines()[-1])


def test_importing_changes_two_settings_and_says_so(imported):
    changed = imported["changed"]
    assert set(changed) == {"environment", "jax"}
    before, after = changed["environment"]
    assert {name for name in after if before.get(name) != after[name]} == {"XLA_FLAGS"}
    before, after = changed["jax"]
    assert {name for name in after if before.get(name) != after[name]} == {"jax_enable_x64"}
    assert "XLA_FLAGS" in imported["said"] and "jax_enable_x64" in imported["said"]


def test_importing_loads_nothing_for_gpus(imported):
    assert not [name for name in imported["modules"] if name.startswith("jaxclear.native.gpu")]


def test_importing_starts_no_device(imported):
    """The user may still choose the platform, the number of devices, or a cluster."""
    assert not imported["started"]


def test_importing_loads_nothing_that_may_come_later(imported):
    assert not LATE & set(imported["modules"])


def test_all_joins_every_extra_of_users():
    """What is left out serves those who work on the package; most systems have a C compiler."""
    project = Path(__file__).parents[1] / "pyproject.toml"
    extras = tomllib.loads(project.read_text())["project"]["optional-dependencies"]
    users = sorted(set(extras) - {"all", "book", "dev", "fmu", "peers", "test"})
    assert extras["all"] == [f"jaxclear[{','.join(users)}]"]


@pytest.mark.slow(sample=False)
def test_the_wheel_holds_what_the_package_reads(tmp_path):
    """Built, unpacked, and used from elsewhere, without the working tree."""
    root = Path(__file__).parents[1]
    tree = tmp_path / "tree"
    ignored = shutil.ignore_patterns(".git", "build", "*.egg-info", "__pycache__")
    shutil.copytree(root, tree, ignore=ignored)
    pip = [sys.executable, "-m", "pip", "-q", "--disable-pip-version-check"]
    subprocess.run([*pip, "wheel", "--no-deps", "-w", tmp_path, tree], check=True)
    wheel = next(tmp_path.glob("jaxclear-*.whl"))
    place = tmp_path / "installed"
    subprocess.run([*pip, "install", "--no-deps", "--target", place, wheel], check=True)
    kept = {str(p.relative_to(place)) for p in place.rglob("*") if p.is_file()}
    for path in (root / "jaxclear").rglob("*"):
        name = str(path.relative_to(root)).removeprefix("jaxclear/commands/before_jax/")
        if path.is_file() and path.suffix != ".pyc":
            assert name in kept, name
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    code = "from jaxclear_command.cli import main; main(['parameters'])"
    said = subprocess.run(
        [sys.executable, "-c", code],
        env=environment | {"PYTHONPATH": str(place)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert 'connections["B"].joint.clearance' in said


SPAWNED = """
import multiprocessing

import numpy as np

import jaxclear as jc


def end(_=None):
    rig = jc.Mechanism(
        bodies={"rod": jc.Body(mass=0.5, inertia=2e-3, com=(0.1, 0.0))},
        connections={"pin": jc.Connection(jc.joint.Revolute(), "ground", "rod")},
        loads={"gravity": jc.load.Gravity((0.0, -9.81))},
    )
    run = jc.simulate(rig, 0.01, save=3, integrator=jc.integrator.FixedStep(1e-4))
    return np.asarray(run.states)[-1].tolist()


if __name__ == "__main__":
    here = end()
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        assert pool.map(end, range(2)) == [here, here]
    print("the same")
"""


@pytest.mark.slow
def test_spawned_processes_compute_the_same(tmp_path):
    (tmp_path / "spawned.py").write_text(SPAWNED)
    root = str(Path(__file__).parents[1])
    done = subprocess.run(
        [sys.executable, tmp_path / "spawned.py"],
        env=os.environ | {"PYTHONPATH": root},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "the same"
