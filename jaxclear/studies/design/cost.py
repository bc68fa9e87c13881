"""What a tolerance costs: a function of its width, the tighter the dearer.

A tolerance is half of the variation that is allowed. Costs are in whatever unit the user counts in;
only their ratios decide the design.
"""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float, Int

from jaxclear.ground.argument_errors import nothing_else
from jaxclear.ground.arguments import expect
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity, vector

__all__ = ["AbstractCost", "Process", "Processes", "Reciprocal", "Table"]
__getattr__, __dir__ = nothing_else("jaxclear.cost", __all__)

MONEY = "(cost)"
FIXED = "cost that no tolerance changes"
# A tolerance that is the finest of a process but for rounding is held.
ROUNDING = 1e-9


class AbstractCost(AbstractQuantified):
    """Cost of a dimension as a function of its tolerance."""

    @abstractmethod
    def __call__(self, tolerance: Scalar) -> Scalar:
        """Cost of a tolerance.

        Args:
            tolerance: half of the allowed variation, in the dimension's unit, > 0.

        Returns:
            The cost.
        """

    def tolerance_range(self) -> tuple[float, float]:
        """Smallest and largest tolerance whose cost is known."""
        return 0.0, float("inf")


class Reciprocal(AbstractCost):
    """$C = C_0 + b/t$.

    Args:
        scale: cost times tolerance b, a number, > 0.
        fixed: cost C_0 that does not depend on the tolerance, a number, >= 0; 0 by default.

    Source: Chase & Greenwood 1988, "Design issues in mechanical tolerance analysis", ASME
    Manufacturing Review 1, 50.
    """

    scale: Scalar = quantity(unit="(cost x tolerance)", meaning="cost times tolerance", above=0)
    fixed: Scalar = quantity(0.0, MONEY, FIXED, at_least=0)

    def __call__(self, tolerance):
        return self.fixed + self.scale / tolerance


class Table(AbstractCost):
    """Costs at given tolerances, with a monotone cubic between them; unknown outside.

    Args:
        tolerances: tolerances in increasing order, two numbers at least, > 0.
        costs: cost of each, numbers.

    Raises:
        ValueError: if there are not as many costs as tolerances, they are not finite, or tolerances
            do not increase.

    Source: Fritsch & Carlson 1980, SIAM J. Numer. Anal. 17, 238, doi:10.1137/0717021.
    """

    tolerances: tuple = vector(unit="(tolerance)", meaning="tolerances, rising, above 0")
    costs: tuple = vector(unit=MONEY, meaning="cost of each")
    coefficients: Float[Array, "4 pieces"]

    def __init__(self, tolerances: Any, costs: Any):
        self.tolerances, self.costs = tolerances, costs
        wide, dear = np.asarray(self.tolerances, float), np.asarray(self.costs, float)
        if len(wide) != len(dear) or len(wide) < 2:
            raise ValueError(
                f"cost.Table has {len(wide)} tolerances and {len(dear)} costs; it must have as "
                "many of the one as of the other, two at least."
            )
        for name, numbers in {"tolerances": wide, "costs": dear}.items():
            for place in np.flatnonzero(~np.isfinite(numbers)):
                raise ValueError(
                    f"cost.Table has {name}[{place}] = {numbers[place]:g}; it must be finite."
                )
        if np.any(np.diff(wide) <= 0) or wide[0] <= 0:
            raise ValueError(
                "tolerances of cost.Table do not rise from above 0; give them in rising order."
            )
        self.coefficients = jnp.asarray(scipy.interpolate.PchipInterpolator(wide, dear).c)

    def tolerance_range(self):
        return float(self.tolerances[0]), float(self.tolerances[-1])

    def __call__(self, tolerance):
        ends = jnp.stack(self.tolerances)
        piece = jnp.clip(jnp.searchsorted(ends, tolerance) - 1, 0, len(self.tolerances) - 2)
        return jnp.polyval(self.coefficients[:, piece], tolerance - ends[piece])


class Process(AbstractCost):
    """A cost within the tolerances that a process can produce.

    Args:
        cost: one of `jaxclear.cost`, an `AbstractCost`.
        finest: smallest tolerance that it can produce, a number in the dimension's unit, > 0.
        coarsest: largest tolerance that it serves, a number in the dimension's unit, > finest.

    Raises:
        ValueError: if coarsest is not the larger.
    """

    cost: AbstractCost
    finest: Scalar = quantity(unit="(tolerance)", meaning="smallest tolerance it holds", above=0)
    coarsest: Scalar = quantity(unit="(tolerance)", meaning="largest tolerance it serves", above=0)

    def __check_init__(self):
        expect(self.cost, AbstractCost, "cost of a Process", "one of jaxclear.cost")
        if not self.finest < self.coarsest:
            raise ValueError(
                f"cost.Process has finest = {float(self.finest):g} and coarsest = "
                f"{float(self.coarsest):g}; coarsest must be the larger."
            )

    def tolerance_range(self):
        low, high = self.cost.tolerance_range()
        return max(low, float(self.finest)), min(high, float(self.coarsest))

    def __call__(self, tolerance):
        return self.cost(tolerance)


class Processes(AbstractCost):
    """Several processes, of which a design chooses one for a dimension, with its tolerance.

    The cost of a tolerance is that of the cheapest process that can produce it. A process also
    serves tolerances beyond its coarsest one, at the cost of that.

    Args:
        processes: `Process` by name, a dictionary, or other costs that are known over a range, such
            as a `Table`.

    Raises:
        ValueError: if there are none, or one is no cost.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    costs: tuple[AbstractCost, ...]
    # Smallest and largest tolerance of each.
    ranges: Float[Array, "processes 2"]
    # The process whose cost alone counts while a design tries it, else -1.
    fixed_process: Int[Array, ""]

    def __init__(self, processes: Any):
        what = "a dictionary from names of processes to members of jaxclear.cost"
        expect(processes, Mapping, "processes of cost.Processes", what)
        if not processes:
            raise ValueError("cost.Processes is empty; name one process at least.")
        for name, cost in processes.items():
            expect(cost, AbstractCost, f'process "{name}"', "one of jaxclear.cost, such as Process")
        self.names, self.costs = tuple(processes), tuple(processes.values())
        self.ranges = jnp.asarray([cost.tolerance_range() for cost in self.costs])
        self.fixed_process = jnp.asarray(-1)

    def tolerance_range(self):
        return float(self.ranges[:, 0].min()), float("inf")

    def __call__(self, tolerance):
        low, high = self.ranges.T
        reached = jnp.clip(tolerance, low, high)
        each = jnp.stack([cost(value) for cost, value in zip(self.costs, reached, strict=True)])
        cheapest = jnp.min(jnp.where(tolerance < low * (1 - ROUNDING), jnp.inf, each))
        return jnp.where(self.fixed_process < 0, cheapest, each[jnp.maximum(self.fixed_process, 0)])

    def process(self, tolerance: float) -> str:
        """Name of the cheapest process that can produce a tolerance.

        Args:
            tolerance: value of the tolerance, in the dimension's unit.

        Returns:
            The name.
        """
        prices = [
            float(self._with_process(k)(jnp.asarray(tolerance, float)))
            if tolerance >= float(self.ranges[k, 0]) * (1 - ROUNDING)
            else np.inf
            for k in range(len(self.costs))
        ]
        return self.names[int(np.argmin(prices))]

    def _with_process(self, process: int) -> "Processes":
        return eqx.tree_at(lambda one: one.fixed_process, self, jnp.asarray(process))
