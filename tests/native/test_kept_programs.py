"""Programs and kernels that an earlier process has left: the same numbers without a trace."""

import json
import os
import shutil
import subprocess
import sys
import time
import warnings
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache

import jaxclear as jc
from jaxclear.ground import cache_folder
from jaxclear.ground.recent_results import Latest
from jaxclear.native import compiled, forms, source_check
from jaxclear.native.compiled import compiled_quickly
from jaxclear.native.forms import Untold, environment_of_program, in_text, tree_in_text

ROOT = Path(jc.__file__).parents[1]
# A run of the slider-crank, what it gives, and what was compiled for it.
PROGRAM = """
import json, sys
import jax
import numpy as np
import jaxclear as jc
built = []
jax.monitoring.register_event_duration_secs_listener(
    lambda name, *_, **told: built.append(told["fun_name"]) if "backend_compile" in name else None
)
rig = jc.scenes.slider_crank()
run = jc.simulate(rig, 0.002, save=5, integrator=jc.integrator.FixedStep(), verify=False)
states = np.asarray(run.history.states).tobytes().hex()
print(json.dumps([states, str(run.stats), [one for one in built if "_" in one]]))
"""


@pytest.fixture
def kept(tmp_path, monkeypatch):
    monkeypatch.setenv(cache_folder.VARIABLE, str(tmp_path))
    monkeypatch.setattr(compiled, "_AT_HAND", Latest(compiled.AT_HAND))
    # These tests put other things in the place of the package's.
    monkeypatch.setattr(source_check, "is_unmodified", lambda: True)
    # Files may have been installed a moment ago.
    monkeypatch.setattr(source_check, "UNCHANGED_SINCE", float("inf"))
    # What JAX finds on disk is not kept again.
    jax.config.update("jax_enable_compilation_cache", False)
    compilation_cache.reset_cache()
    yield tmp_path
    jax.config.update("jax_enable_compilation_cache", True)
    compilation_cache.reset_cache()


def another_process(folder, program=PROGRAM):
    environment = os.environ | {cache_folder.VARIABLE: str(folder), "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.slow
def test_another_process_compiles_nothing_and_gives_the_same_numbers(tmp_path):
    first, second = (another_process(tmp_path) for _ in range(2))
    assert {"jit(_run_differentiable)", "jit(_find_start)"} <= set(first[2])
    assert second[:2] == first[:2] and "machine code" in second[1]
    assert not {"jit(_run_differentiable)", "jit(_find_start)"} & set(second[2])
    # Without one of its kernels a program is compiled again.
    for path in (tmp_path / "programs").glob("*.kernel"):
        path.unlink()
    again = another_process(tmp_path)
    assert again[:2] == first[:2] and "jit(_run_differentiable)" in again[2]


@pytest.mark.slow
def test_what_jax_has_kept_is_not_kept_again(tmp_path, monkeypatch):
    """JAX's cache outlives programs that were cleared, or those of another version."""
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "jax"))
    monkeypatch.setenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    first = another_process(tmp_path)
    for path in (tmp_path / "programs").glob("*.program"):
        path.unlink()
    second, third = (another_process(tmp_path) for _ in range(2))
    assert first[:2] == second[:2] == third[:2]


TRACED = []


def scaled(x, by, words):
    """A function of this module: known by a name, but of no library."""
    TRACED.append(words)
    return {"scaled": x * by, "words": words, "as given": x}


def test_what_is_no_array_comes_back_as_it_was(kept, monkeypatch):
    monkeypatch.setattr(forms, "TRUSTED", (*forms.TRUSTED, "tests"))
    monkeypatch.setattr(compiled, "_supported", lambda options, _: dict(options))
    known = compiled_quickly(scaled)
    TRACED.clear()
    found = known(jnp.arange(3.0), 2, ("a", None))
    compiled._AT_HAND.entries.clear()
    again = known(np.ones(3), 2, ("a", None))
    assert TRACED == [("a", None)]
    assert again["words"] == ("a", None) and again["scaled"].tolist() == [2.0, 2.0, 2.0]
    assert found["scaled"].tolist() == [0.0, 2.0, 4.0] and again["as given"].tolist() == [1] * 3
    # Another number that is no array, another shape, type or kind of thing is another program.
    for x, by, words in [
        (jnp.ones(3), 3, ("a", None)),
        (jnp.ones(3), 2.0, ("a", None)),
        (jnp.ones(3), True, ("a", None)),
        (jnp.ones(4), 2, ("a", None)),
        (jnp.ones(3, int), 2, ("a", None)),
        (jnp.ones(3), 2, ["a", None]),
    ]:
        before = len(TRACED)
        assert known(x, by, words)["scaled"].tolist() == [by] * len(x)
        assert len(TRACED) == before + 1


LAW = """
def f(x, k={factor}):
    traced.append(k)
    return {factor} * x

def from_a_file(x):
    return float(open("/a/file").read()) * x

class Law(eqx.Module):
    def __call__(self, x): return {factor} * x
"""


def a_users(name, factor, traced=()):
    space = {"__name__": "a_notebook", "eqx": eqx, "traced": traced}
    exec(LAW.format(factor=factor), space)
    return space[name]


@compiled_quickly
def applied(function, x):
    return function(x)


def test_what_belongs_to_a_user_is_found_by_what_it_does(kept):
    """Not by its name: a cell of a notebook that is run again is the same, an edited one is not."""
    for name in ("f", "Law"):
        one, same, other = (a_users(name, factor) for factor in (2.0, 2.0, 3.0))
        assert in_text(one) == in_text(same) != in_text(other)
    assert in_text(a_users("Law", 2.0)()) != in_text(a_users("Law", 3.0)())
    # What may hang on more than its text shows has none.
    for thing in (a_users("from_a_file", 2.0), np.array([None]), np.random.default_rng()):
        with pytest.raises(Untold):
            in_text(thing)
    rig = jc.scenes.slider_crank()
    told = tree_in_text(jax.tree.structure(rig))
    assert told == tree_in_text(jax.tree.structure(jc.scenes.slider_crank()))
    assert told != tree_in_text(jax.tree.structure(jc.scenes.slider_crank(friction=False)))


def test_a_cell_that_is_run_again_compiles_nothing(kept, monkeypatch):
    monkeypatch.setattr(forms, "TRUSTED", (*forms.TRUSTED, "tests"))
    monkeypatch.setattr(compiled, "_supported", lambda options, _: dict(options))
    traced: list = []

    def ask(factor):
        # A list that grows would tell one from the other.
        found = applied(a_users("f", factor, Quiet(traced)), jnp.ones(2))
        assert found.tolist() == [factor] * 2
        return len(traced)

    assert [ask(2.0), ask(2.0), ask(3.0), ask(2.0)] == [1, 1, 2, 2]


class Quiet:
    """A list that shows nothing of its content."""

    def __init__(self, content):
        self.append = content.append


def test_settings_make_another_program(monkeypatch):
    monkeypatch.setattr(source_check, "_CONTENTS", {})
    before = environment_of_program()
    assert environment_of_program() == before
    monkeypatch.setenv("JAXCLEAR_PLAIN_LOOPS", "1")
    other = environment_of_program()
    monkeypatch.delenv("JAXCLEAR_PLAIN_LOOPS")
    with jax.default_matmul_precision("highest"):
        assert len({before, other, environment_of_program()}) == 3


def test_settings_that_change_within_a_process_make_another_program(kept, monkeypatch):
    monkeypatch.setattr(forms, "TRUSTED", (*forms.TRUSTED, "tests"))
    known = compiled_quickly(scaled)
    x = np.ones(2, np.float32)
    wide = known(x, np.float64(2.0), "")["scaled"].dtype
    with jax.enable_x64(False):
        narrow = known(x, np.float64(2.0), "")["scaled"].dtype
    assert (wide, narrow) == (np.float64, np.float32)


def test_a_package_that_is_changed_in_a_process_is_not_found_by_its_names(monkeypatch):
    """A friction law of the user's put in the place of the package's took a program of its own
    name from disk."""
    from jaxclear.laws import friction
    from jaxclear.studies.identification import regression

    patches = [
        lambda on: on.setattr(friction.CoulombTanh, "coefficient", lambda self, speed: speed),
        lambda on: on.setattr(friction.CoulombTanh, "largest_slope", None, raising=False),
        lambda on: on.setattr(friction.CoulombTanh, "__eq__", lambda self, other: True),
        lambda on: on.setattr(regression, "LINE", 0.3),
        lambda on: on.setattr(compiled, "_key", lambda *_: None),
        lambda on: on.delattr(regression, "LINE"),
    ]
    monkeypatch.setattr(source_check, "_CONTENTS", {})
    for patch in patches:
        environment_of_program()
        with monkeypatch.context() as on:
            patch(on)
            with pytest.raises(Untold, match="changed in this process"):
                environment_of_program()


def test_files_count_by_what_stands_in_them(tmp_path):
    one = tmp_path / "law.py"

    def written(text, days=1):
        one.write_text(text)
        os.utime(one, (time.time() - 86400 * days,) * 2)
        return forms._files(tmp_path)

    with pytest.raises(Untold, match="edited since it was read"):
        written("MU = 0.3")
    # A day from now this process began.
    with pytest.MonkeyPatch.context() as on:
        on.setattr(source_check, "UNCHANGED_SINCE", time.time() + 86400)
        before = written("MU = 0.3")
        assert written("MU = 0.4") != before == written("MU = 0.3", days=2)


def test_a_package_that_was_installed_a_moment_ago_keeps_its_programs(tmp_path):
    """As the first command after an installation does."""
    shutil.copytree(ROOT / "jaxclear", tmp_path / "site" / "jaxclear")
    program = "from jaxclear.native.forms import environment_of_program as read; read()"
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "site")}
    subprocess.run([sys.executable, "-c", program], env=environment, cwd=tmp_path, check=True)


@pytest.mark.parametrize("hits", [0, 1])
def test_a_program_that_jax_has_found_is_not_kept(hits, kept, monkeypatch):
    real = jax.stages.Lowered.compile

    def found(self, **given):
        for _ in range(hits):
            jax.monitoring.record_event(compiled.CACHE_HIT_EVENT)
        return real(self, **given)

    monkeypatch.setattr(forms, "TRUSTED", (*forms.TRUSTED, "tests"))
    monkeypatch.setattr(jax.stages.Lowered, "compile", found)
    compiled_quickly(scaled)(jnp.ones(2), 3.0, ("a",))
    assert (
        len([one for one in cache_folder.list_files() if one.path.suffix == ".program"]) == 1 - hits
    )


def test_a_program_that_calls_back_is_not_kept_and_runs(kept, monkeypatch):
    monkeypatch.setattr(forms, "TRUSTED", (*forms.TRUSTED, "tests"))
    heard = []
    monkeypatch.setitem(globals(), "calling", None)

    def calling(x):
        jax.debug.callback(heard.append, x)
        return 2 * x

    calling.__qualname__ = "calling"
    monkeypatch.setitem(globals(), "calling", calling)
    known = compiled_quickly(calling)
    assert [float(known(jnp.asarray(value))) for value in (1.0, 2.0)] == [2.0, 4.0]
    jax.effects_barrier()
    assert [float(one) for one in heard] == [1.0, 2.0]
    assert not [one for one in cache_folder.list_files() if one.path.suffix == ".program"]


@pytest.mark.parametrize("within", [jax.jit, jax.vmap, jax.grad])
def test_within_another_program_nothing_is_looked_up(kept, within, monkeypatch):
    monkeypatch.setattr(forms, "TRUSTED", (*forms.TRUSTED, "tests"))
    known = compiled_quickly(scaled)
    x = jnp.ones(2) if within is jax.vmap else jnp.asarray(1.0)
    assert jnp.all(within(lambda x: known(x, 2.0, "")["scaled"])(x) == 2.0)
    assert cache_folder.list_files() == []


def test_a_number_of_any_type_compiles_nothing_anew(kept, monkeypatch):
    """`equinox.tree_at` puts it into its place as it is."""
    rig = jc.scenes.slider_crank("ideal")
    run = lambda mass: jc.simulate(
        eqx.tree_at(lambda rig: rig.bodies["rod"].mass, rig, mass),
        1e-3,
        integrator=jc.integrator.FixedStep(1e-3),
        save=2,
        verify=False,
    )
    first = run(np.float64(2.0))
    monkeypatch.setattr(compiled, "_load_or_compile", lambda *_: pytest.fail("compiled anew"))
    for kind in (float, int, np.float32, np.float64, np.int64, np.asarray, jnp.float32):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = run(kind(3))
        mass = found.mechanism.bodies["rod"].mass
        assert mass.dtype == np.float64 and mass == 3.0
        assert jax.tree.structure(found) == jax.tree.structure(first)


def test_programs_of_other_functions_are_let_go(kept, monkeypatch):
    """What a process has at hand is bounded by its memory, whatever is asked: each new function of
    time is a new program."""
    latest = Latest(3 * compiled.A_PROGRAM)
    monkeypatch.setattr(compiled, "_AT_HAND", latest)
    for i in range(5):
        times = compiled_quickly(lambda x, i=i: i * x)
        assert times(jnp.asarray(2.0)) == 2 * i and times(jnp.asarray(3.0)) == 3 * i
    assert len(latest.entries) == 2
    assert sum(size for _, size in latest.entries.values()) <= latest.most


@pytest.mark.parametrize(("patience", "said"), [(0.0, 1), (60.0, 0)])
def test_who_waits_is_told_what_is_compiled(kept, monkeypatch, caplog, patience, said):
    def slow(x):
        """A search for what takes long."""
        time.sleep(0.5)
        return 2 * x

    monkeypatch.setattr(compiled, "PATIENCE", patience)
    assert compiled_quickly(slow)(jnp.asarray(2.0)) == 4.0
    sentence = f"compiling for {patience:g} s: A search for"
    assert len([each for each in caplog.messages if sentence in each]) == said
