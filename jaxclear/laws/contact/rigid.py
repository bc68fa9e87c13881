"""Contact without compliance: bodies that do not overlap."""

from typing import ClassVar

from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.laws.contact.base import AbstractNormalLaw


class Rigid(AbstractNormalLaw):
    """No stiffness, no function of the indentation: for integrator.MoreauJean and NonColliding.

    An impact in which one contact closes ends with restitution times the speed before (Newton).
    Where a force is wanted as a function, take CarvalhoMartins.

    Source: Newton 1687, Principia; as a complementarity of percussion and velocity Moreau 1988, in
    Nonsmooth Mechanics and Applications, 1, doi:10.1007/978-3-7091-2624-0_1.
    """

    restitution: Scalar = quantity(
        0.9, "1", "coefficient of restitution c_e, 0 <= c_e <= 1", at_least=0, at_most=1
    )
    compliant: ClassVar[bool] = False
    remembers_impact_speed: ClassVar[bool] = False

    def elastic_force(self, indentation: Scalar) -> Scalar:
        """Nothing is stored."""
        return 0.0
