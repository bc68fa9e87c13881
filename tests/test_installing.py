"""What importing jaxclear does to the process it is imported into: it loads no library before that
is needed, starts no device, and of the user's settings changes two, which its text names."""

import json
import os
import subprocess
import sys

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


def test_importing_starts_no_device(imported):
    """The user may still choose the platform, the number of devices, or a cluster."""
    assert not imported["started"]


def test_importing_loads_nothing_that_may_come_later(imported):
    assert not LATE & set(imported["modules"])
