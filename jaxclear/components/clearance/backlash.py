"""Play along one coordinate: of gears, of a belt, of a joint."""

import equinox as eqx

from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity
from jaxclear.laws.flank import AbstractFlankLaw, Nordin


class Backlash(AbstractQuantified):
    """Play of a coupling: the way from one flank to the other, as what it couples goes free.

    `play`: the whole of it, half on each side of the `middle`, where the flanks are found; `law`:
    how a flank presses, one of `jaxclear.flank`. Stiffness and damping are those of the coupling.
    With a `restitution` flanks are rigid in `MoreauJean`, and the parts leave one with this share
    of the speed with which they meet it; stiffness and damping then count nothing there. `seated`:
    the flanks always press, as `NonColliding` takes them: the coupling moves as one without play,
    and what it transmits tells which flank presses (`Trajectory.coupling`).
    """

    play: Scalar = quantity(
        unit="rad", meaning="way from flank to flank (m for a sliding joint)", at_least=0
    )
    middle: Scalar | None = quantity(
        None, "rad", "where the middle of the play is (m for a sliding joint)", kw_only=True
    )
    law: AbstractFlankLaw = eqx.field(default_factory=Nordin, kw_only=True)
    restitution: Scalar | None = quantity(
        None,
        "1",
        "share of the speed with which rigid flanks part",
        at_least=0,
        at_most=1,
        kw_only=True,
    )
    seated: bool = eqx.field(static=True, default=False, kw_only=True)
