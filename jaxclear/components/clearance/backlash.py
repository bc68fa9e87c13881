"""Play along one coordinate: of gears, of a belt, of a joint."""

import equinox as eqx

from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity
from jaxclear.laws.flank import AbstractFlankLaw, Nordin


class Backlash(AbstractQuantified):
    """Play of a coupling: the way from one flank to the other, as what it couples goes free.

    `play`: the whole of it, half on each side of the `middle`, where the flanks are found; `law`:
    how a flank presses, one of `jaxclear.flank`. Stiffness and damping are those of the coupling.
    """

    play: Scalar = quantity(
        unit="rad", meaning="way from flank to flank (m for a sliding joint)", at_least=0
    )
    middle: Scalar | None = quantity(
        None, "rad", "where the middle of the play is (m for a sliding joint)", kw_only=True
    )
    law: AbstractFlankLaw = eqx.field(default_factory=Nordin, kw_only=True)
