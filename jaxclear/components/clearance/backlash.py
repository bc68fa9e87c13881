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


def _as_wearing(value: Any) -> Any:
    return Wearing(value) if isinstance(value, AbstractWearLaw) else value


class Backlash(AbstractQuantified):
    """Play of a coupling: its parts move freely from one flank to the other.

    Stiffness and damping of the flanks are those of the coupling. With a `wear` each flank loses
    volume while it presses, by the normal force (torque over `pitch_radius` r) at a sliding speed
    of `slide` times r times the speed of the coordinate along which play is seen, with a friction
    of 0 (an energy law wears nothing). The volume over `area` is the worn depth h, and the flank's
    side of the play grows by h / r at the saving times. The worn surfaces are "upper" and "lower"
    of the coupling's name (`Trajectory.worn_depth`).

    Args:
        play: travel from flank to flank [rad; m for a sliding joint], >= 0, half on each side of
            the middle.
        middle: middle of the play [rad; m for a sliding joint]; None: 0.
        law: how a flank presses, one of `jaxclear.flank`; `Nordin` by default.
        restitution: share of the speed with which rigid flanks part [1], >= 0 and <= 1. With it
            flanks are rigid in `MoreauJean`, where stiffness and damping count nothing; None by
            default.
        in_contact: whether the flanks always press, as `NonColliding` takes them: the coupling
            moves as one without play, and the sign of what it transmits tells which flank presses
            (`Trajectory.coupling`).
        wear: wear law of `jaxclear.wear`, or a `Wearing`; none by default.
        slide: sliding distance of a flank per distance along its pitch line [1], >= 0; needed with
            wear.
        area: area of a flank that wears, of all teeth that take turns [m^2], > 0; needed with wear.
        pitch_radius: lever r of a flank's normal force [m], > 0, of an involute the base radius;
            None, for a play that is a length: 1.

    Raises:
        ValueError: for wear without slide or area, or for slide, area or pitch_radius without wear.
    """

    play: Scalar = quantity(unit="rad", sliding="m", at_least=0)
    middle: Scalar | None = quantity(None, "rad", sliding="m", kw_only=True)
    law: AbstractFlankLaw = eqx.field(default_factory=Nordin, kw_only=True)
    restitution: Scalar | None = quantity(None, "1", at_least=0, at_most=1, kw_only=True)
    in_contact: bool = eqx.field(static=True, default=False, kw_only=True)
    wear: Wearing | None = eqx.field(default=None, converter=_as_wearing, kw_only=True)
    slide: Scalar | None = quantity(None, "1", at_least=0, kw_only=True)
    area: Scalar | None = quantity(None, "m^2", above=0, kw_only=True)
    pitch_radius: Scalar | None = quantity(None, "m", above=0, kw_only=True)

    def __check_init__(self):
        fields = [name for name in ("slide", "area") if getattr(self, name) is not None]
        if self.wear is not None and len(fields) < 2:
            raise ValueError(
                "a Backlash that wears needs slide, how far its flanks slide, and area, over which "
                "the worn volume is a depth."
            )
        fields += [] if self.pitch_radius is None else ["pitch_radius"]
        if self.wear is None and fields:
            raise ValueError(
                f"a Backlash has {fields[0]} and no wear, which alone reads it; give wear, a law "
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
        """Volume per time that a pressing flank loses.

        Args:
            torque: torque of the flank [N m; N where play is a length].
            speed: speed of the coordinate along which play is seen [rad/s; m/s where play is a
                length].

        Returns:
            the rate [m^3/s].
        """
        wear: Any = self.wear
        slip = self.slide * self.lever * jnp.abs(speed)
        return wear.acceleration * wear.law.volume_rate(torque / self.lever, slip, 0.0 * torque)

    def grown(self, worn: dict[str, Any]) -> "Backlash":
        """The play between worn flanks.

        Args:
            worn: worn depth of the flanks "upper" and "lower" [m], a dict.

        Returns:
            the `Backlash` with its larger play and its new middle.
        """
        upper, lower = (worn[flank] / self.lever for flank in FLANKS)
        middle = middle_of(self) + 0.5 * (upper - lower)
        numbers = {"play": self.play + upper + lower, "middle": middle}
        return dataclasses.replace(self, **numbers)


def middle_of(play: Backlash) -> Any:
    """Where the middle of a play is, 0 where nothing is told."""
    return 0 if play.middle is None else play.middle
