"""What is lost: the rate at which a sliding contact wears material away.

Rates in m^3/s of the surface that the law is given to; zero at rest and without load. Where both
surfaces of a joint wear, each has a law with a coefficient of its own. Where the volume goes is the
wear map's business.
"""

from abc import abstractmethod

from jaxclear.ground.argument_errors import nothing_else
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.laws.law import AbstractLaw

__all__ = ["AbstractWearLaw", "Archard", "Fouvry"]
__getattr__, __dir__ = nothing_else("jaxclear.wear", __all__)


# From soft polymers to diamond: Ashby 2011, Materials Selection in Mechanical Design, 4th ed.
USUAL_HARDNESS = (1e6, 1.5e11, "is it in MPa, or a Brinell number (9.8e6 Pa each)? It is in Pa.")


class AbstractWearLaw(AbstractLaw):
    """Worn volume per time of one contact point."""

    @abstractmethod
    def volume_rate(self, normal_force: Scalar, slip_speed: Scalar, traction: Scalar) -> Scalar:
        """Volume that the surface loses per time.

        Args:
            normal_force: load [N], >= 0.
            slip_speed: sliding speed [m/s], >= 0.
            traction: friction force [N], >= 0; 0 without friction.

        Returns:
            worn volume per time [m^3/s], >= 0.
        """


class Archard(AbstractWearLaw):
    r"""Worn volume in proportion to load and sliding distance.

    :math:`\dot V = k F_n v/H`. Use for mild dry wear at steady load; for impact-dominated or
    fretting joints prefer Fouvry.

    Args:
        wear_coefficient: share k of contact events that shed a particle [1], >= 0.
        hardness: indentation hardness H of the softer body [Pa], > 0.

    Source: Archard 1953, J. Appl. Phys. 24, 981, eq. 4, doi:10.1063/1.1721448; for clearance joints
    Hou, Deng & Zeng 2021, J. Cent. South Univ. 28, 712, eq. 25, doi:10.1007/s11771-021-4640-y.
    """

    wear_coefficient: Scalar = quantity(1e-5, "1", at_least=0)
    hardness: Scalar = quantity(2e9, "Pa", above=0, usual=USUAL_HARDNESS)

    @classmethod
    def from_specific_wear(cls, specific_wear: Scalar, hardness: Scalar = 2e9) -> "Archard":
        """The law of a specific wear rate k/H, as tests and tables give it.

        Args:
            specific_wear: worn volume per load and sliding distance [mm^3/(N m)], >= 0; some 1e-7
                of oiled, 1e-4 of dry steel.
            hardness: hardness H of the softer body [Pa], > 0.

        Returns:
            The law, with k = 1e-9 `specific_wear` `hardness`.
        """
        return cls(wear_coefficient=1e-9 * specific_wear * hardness, hardness=hardness)

    def volume_rate(self, normal_force: Scalar, slip_speed: Scalar, traction: Scalar) -> Scalar:
        return self.wear_coefficient * normal_force * slip_speed / self.hardness


class Fouvry(AbstractWearLaw):
    r"""Worn volume in proportion to the energy that friction dissipates.

    :math:`\dot V = \alpha F_t v`. Use for fretting and for reciprocating joints whose friction
    varies; without friction it gives no wear at all, there prefer Archard. Equal to Archard with
    :math:`k/H = \alpha\mu` at constant :math:`\mu`.

    Args:
        energy_wear_coefficient: worn volume alpha per dissipated energy [m^3/J], >= 0.

    Source: Fouvry, Liskiewicz, Kapsa, Hannel & Sauger 2003, Wear 255, 287,
    doi:10.1016/S0043-1648(03)00117-0; the default is of the order reported for steels.
    """

    energy_wear_coefficient: Scalar = quantity(2e-14, "m^3/J", at_least=0)

    def volume_rate(self, normal_force: Scalar, slip_speed: Scalar, traction: Scalar) -> Scalar:
        return self.energy_wear_coefficient * traction * slip_speed
