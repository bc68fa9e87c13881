"""What tests of kernels share."""

import pytest

from jaxclear.native import loop


@pytest.fixture(autouse=True, scope="module")
def as_users(optimised_kernels):
    """Kernels are optimised as users' are."""


@pytest.fixture
def built(monkeypatch):
    """The loops that become kernels."""
    programs, build = [], loop.kernels.build
    watched = lambda program, *rest: programs.append(program) or build(program, *rest)
    monkeypatch.setattr(loop.kernels, "build", watched)
    return programs


@pytest.fixture
def checked(monkeypatch):
    """One turn of every new kernel is compared with JAX, operation by operation."""
    monkeypatch.setenv("JAXCLEAR_CHECK_KERNELS", "1")
