"""Whether numbers are of double precision: gaps of 1e-5 m beside coordinates of 1 m have no meaning
in single precision, so whatever computes looks first; here it also learns that it was forked."""

from typing import Any

import jax

from jaxclear.ground.forking import check_not_forked

__all__ = ["check_double_precision"]


def check_double_precision() -> None:
    """Raises `RuntimeError` where float64 has been switched off since jaxclear was imported, and in
    the child of a fork (see `forking`)."""
    check_not_forked()
    # Not every version of JAX names its settings to type checkers.
    settings: Any = jax.config
    if not settings.jax_enable_x64:
        raise RuntimeError(
            "jaxclear needs float64, and jax_enable_x64 has been switched off: leave it on "
            "(importing jaxclear switches it on)."
        )
