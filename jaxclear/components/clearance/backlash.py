"""Play along one coordinate: of gears, of a belt, of a joint."""

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.wear_map import AreaMap, Wearing
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity
from jaxclear.laws.flank import AbstractFlankLaw, Nordin
from jaxclear.laws.wear import AbstractWearLaw

FLANKS = ("upper", "lower")


def _as_wearing(given: Any) -> Any:
    return Wearing(given) if isinstance(given, AbstractWearLaw) else given


class Backlash(AbstractQuantified):
    """Play of a coupling: the way from one flank to the other, as what it couples goes free.

    `play`: the whole of it, half on each side of the `middle`, where the flanks are found; `law`:
    how a flank presses, one of `jaxclear.flank`. Stiffness and damping are those of the coupling.
    With a `restitution` flanks are rigid in `MoreauJean`, and the parts leave one with this share
    of the speed with which they meet it; stiffness and damping then count nothing there. `seated`:
    the flanks always press, as `NonColliding` takes them: the coupling moves as one without play,
    and what it transmits tells which flank presses (`Trajectory.coupling`).

    `wear`: a law of `jaxclear.wear` (or a `Wearing`) by which each flank loses volume while it
    presses, by the normal force, the torque over the `pitch_radius` r, at a sliding speed of
    `slide` times r times the speed of the coordinate along which play is seen; with a friction of 0
    (an energy law wears nothing). The volume over the `area` of the flank, of all teeth that take
    turns, is its worn depth h, and its side of the play grows by h / r at the saving times, as
    other surfaces wear. Where play is a length r is left out, and counts as 1. The worn surfaces
    are "upper" and "lower" of the coupling's name (`Trajectory.worn_depth`).
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
    wear: Wearing | None = eqx.field(default=None, converter=_as_wearing, kw_only=True)
    slide: Scalar | None = quantity(
        None, "1", "way that a flank slides per way along its pitch line", at_least=0, kw_only=True
    )
    area: Scalar | None = quantity(
        None, "m^2", "area of a flank that wears, of all teeth", above=0, kw_only=True
    )
    pitch_radius: Scalar | None = quantity(
        None,
        "m",
        "lever of a flank's normal force: of an involute the base radius",
        above=0,
        kw_only=True,
    )

    def __check_init__(self):
        given = [name for name in ("slide", "area") if getattr(self, name) is not None]
        if self.wear is not None and len(given) < 2:
            raise ValueError(
                "a Backlash that wears needs slide, how far its flanks slide, and area, over which "
                "the worn volume is a depth."
            )
        given += [] if self.pitch_radius is None else ["pitch_radius"]
        if self.wear is None and given:
            raise ValueError(
                f"a Backlash has {given[0]} and no wear, which alone reads it; give wear, a law "
                "such as wear.Archard()."
            )

    def maps(self) -> dict:
        """Wear map and law of each flank; none where they do not wear."""
        if self.wear is None:
            return {}
        return {flank: (AreaMap(self.area), self.wear) for flank in FLANKS}

    @property
    def lever(self) -> Any:
        """What a depth is divided by to be in the unit of play; 1 where that is a length."""
        return 1.0 if self.pitch_radius is None else self.pitch_radius

    def wear_rate(self, torque: Scalar, speed: Scalar) -> Scalar:
        """Volume [m3/s] that a flank loses which presses with a torque [N m, N], at a speed [rad/s,
        m/s] of the coordinate along which play is seen."""
        wear: Any = self.wear
        slip = self.slide * self.lever * jnp.abs(speed)
        return wear.acceleration * wear.law.volume_rate(torque / self.lever, slip, 0.0 * torque)

    def grown(self, worn: dict[str, Any]) -> "Backlash":
        """The play between flanks worn so deep [m]."""
        upper, lower = (worn[flank] / self.lever for flank in FLANKS)
        middle = middle_of(self) + 0.5 * (upper - lower)
        numbers = {"play": self.play + upper + lower, "middle": middle}
        return dataclasses.replace(self, **numbers)


def middle_of(play: Backlash) -> Any:
    """Where the middle of a play is, 0 where nothing is told."""
    return 0 if play.middle is None else play.middle
