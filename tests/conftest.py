"""What holds for every test: examples that are drawn are the same in every run, unless asked
otherwise.
"""

import os

import jax
import pytest
from hypothesis import settings
from jax.experimental.compilation_cache import compilation_cache

settings.register_profile("repeatable", derandomize=True, deadline=None)
# HYPOTHESIS_PROFILE=searching draws anew in every run and prints how to repeat what fails.
settings.register_profile("searching", deadline=None, print_blob=True)
settings.load_profile(
    "repeatable" if os.environ.get("CI") else os.environ.get("HYPOTHESIS_PROFILE", "repeatable")
)


@pytest.fixture
def keep_settings():
    """Settings of JAX that a command changes for its process are put back afterwards."""
    names = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = {name: getattr(jax.config, name) for name in names}
    yield
    for name, value in before.items():
        jax.config.update(name, value)
    compilation_cache.reset_cache()
