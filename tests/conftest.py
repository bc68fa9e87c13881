"""What holds for every test: examples that are drawn are the same in every run, unless asked
otherwise, and compiled programs do not pile up. Most of a test is compiling, so what XLA compiles
is optimised little (a third of the suite), kernels not at all (a seventh; as users' are where a
test says so), and Python looks for cycles of garbage rarely (a twentieth). Flags of XLA that a user
sets go before."""

import functools
import gc
import os
from pathlib import Path
from zlib import crc32

import jax
import pytest
from hypothesis import settings
from jax._src.interpreters import mlir
from jax.experimental.compilation_cache import compilation_cache

from jaxclear.errors import verification
from jaxclear.native import object_code

# XLA reads them when it starts, which no import does. Of a program of one operation half the time
# goes into compilers for fusions, which are set up anew for each program; level 0 has no
# multiplication and addition in one, so sums end in other digits than those of kernels. A flag that
# an XLA does not have ends its process; that of JAX 0.12 has no other emitters of fusions.
LITTLE_OPTIMISED = (
    "--xla_backend_optimization_level=1 --xla_llvm_disable_expensive_passes=true "
    "--xla_cpu_parallel_codegen_split_count=1"
)
if jax.__version_info__ < (0, 12):
    LITTLE_OPTIMISED += " --xla_cpu_use_fusion_emitters=false"
# LLVM optimises a kernel three times as long as it writes its code.
USERS_SPEED_LEVEL = object_code.SPEED_LEVEL
object_code.SPEED_LEVEL = 0
# Machine code is kept where a test is about that.
os.environ["JAXCLEAR_CACHE"] = "0"
os.environ["XLA_FLAGS"] = f"{LITTLE_OPTIMISED} {os.environ.get('XLA_FLAGS', '')}".strip()
gc.set_threshold(300_000, 20, 1000)
# A fifth of the time of a program of one operation goes into a context of MLIR, which JAX makes
# for each: those of a file share one.
mlir.make_ir_context = functools.lru_cache(1)(mlir.make_ir_context)

settings.register_profile("repeatable", derandomize=True, deadline=None)
# HYPOTHESIS_PROFILE=searching draws anew in every run and prints how to repeat what fails.
settings.register_profile("searching", deadline=None, print_blob=True)
settings.load_profile(
    "repeatable" if os.environ.get("CI") else os.environ.get("HYPOTHESIS_PROFILE", "repeatable")
)


def pytest_addoption(parser):
    parser.addoption(
        "--slow-sample",
        action="store_true",
        help="with `-m slow`: one case of each slow function, none marked `slow(sample=False)`",
    )


def pytest_collection_modifyitems(config, items):
    """With `--slow-sample` one case of each slow function stays, and one more of each forty, spread
    and the same in every run."""
    if not config.getoption("slow_sample"):
        return
    functions, chosen = {}, set()
    for item in items:
        marker = item.get_closest_marker("slow")
        if marker is not None and marker.kwargs.get("sample", True):
            functions.setdefault(item.nodeid.partition("[")[0], []).append(item)
    for name, cases in functions.items():
        first, size, count = crc32(name.encode()), len(cases), 1 + len(cases) // 40
        chosen |= {cases[(first + k * size // count) % size] for k in range(count)}
    items[:] = [item for item in items if item in chosen]


# Every compiled program maps pieces of memory, a few tens of them. Linux allows a process 65 530;
# beyond, XLA crashes. What is dropped is compiled again, small programs above all.
MAPS, MOST_MAPS = Path("/proc/self/maps"), 50_000


@pytest.fixture(autouse=True, scope="module")
def few_programs():
    """Programs of the files before are dropped where they are many."""
    mlir.make_ir_context.cache_clear()
    yield
    if MAPS.exists() and MAPS.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()
        gc.collect()


@pytest.fixture
def young_garbage():
    """Collections of garbage look at what the test has made: not at millions of objects of others,
    at seconds each."""
    gc.freeze()
    yield
    gc.unfreeze()


@pytest.fixture(scope="module")
def optimised_kernels():
    """Kernels are optimised as users' are."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(object_code, "SPEED_LEVEL", USERS_SPEED_LEVEL)
        yield


@pytest.fixture
def keep_settings():
    """Settings of JAX that a command changes for its process are put back afterwards."""
    names = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = {name: getattr(jax.config, name) for name in names}
    yield
    for name, value in before.items():
        jax.config.update(name, value)
    compilation_cache.reset_cache()


# Steps up to which users' runs have replicas.
USERS_MOST_STEPS = verification.MOST_STEPS


@pytest.fixture(autouse=True, scope="module")
def without_replicas(request):
    """Runs have replicas where a test asks for them (`verify=True`) or is marked `verified`: the
    mechanics of most tests is that of single runs. Fixtures of a file as its tests."""
    with pytest.MonkeyPatch.context() as patch:
        if request.node.get_closest_marker("verified") is None:
            patch.setattr(verification, "MOST_STEPS", -1)
        yield


@pytest.fixture(autouse=True)
def with_replicas(request, monkeypatch):
    """Those of a test that is marked by itself."""
    if request.node.get_closest_marker("verified") is not None:
        monkeypatch.setattr(verification, "MOST_STEPS", USERS_MOST_STEPS)
