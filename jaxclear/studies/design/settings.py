"""How a design is sought: what a limit is let pass, sizes of samples, which optimiser."""

import equinox as eqx

from jaxclear.ground.arguments import check_count, check_known
from jaxclear.ground.quantity import AbstractQuantified, Scalar, count, quantity

__all__ = ["DesignSettings"]

METHODS = ("auto", "slsqp", "optax", "noisy")
# More free numbers than this are searched by steps of optax.
TENS = 40


class DesignSettings(AbstractQuantified):
    """`allowed_excess` [1]: by how much of itself a limit may be missed. `samples`: points at which
    a surface, or a problem that answers at once, is taken; `check`: runs of a verification, `runs`:
    of a surface (None: two for each term of a quadratic, 64 at least). `rounds`: verifications at
    the most. `method`: "slsqp", "optax" (an augmented Lagrangian), "noisy" (the same on new runs in
    every step, by score functions: for responses that jump, rattle or count, which no surface
    explains), or "auto", the first or second by how many numbers are free. `surface`: whether one
    stands in for the problem (None: unless it answers at once)."""

    allowed_excess: Scalar = quantity(
        5e-3, "1", "miss of a limit that is let pass", above=0, below=1
    )
    samples: int = count(2048, "points of a population", at_least=64)
    check: int = count(128, "runs of a verification", at_least=16)
    runs: int | None = eqx.field(static=True, default=None)
    rounds: int = count(6, "verifications at the most")
    seed: int = count(0, "seed of all random numbers", at_least=0)
    method: str = eqx.field(static=True, default="auto")
    surface: bool | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        check_known("method of a design", self.method, METHODS)
        if self.runs is not None:
            check_count("runs of DesignSettings", self.runs)

    @property
    def noisy(self) -> bool:
        """Whether steps see new runs each."""
        return self.method == "noisy"

    def uses_steps(self, free: int) -> bool:
        """Whether optax takes the steps for so many free numbers."""
        return self.method == "optax" or (self.method == "auto" and free > TENS)
