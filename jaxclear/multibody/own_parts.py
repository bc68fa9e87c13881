"""Loads and drives of a user's own class answer what the equations of motion take from them: looked
at once, by shapes alone, where a mechanism is built.
"""

import itertools
from typing import Any

import jax
import jax.numpy as jnp

from jaxclear.components.drive import AbstractDrive
from jaxclear.components.load import (
    AbstractBodyLoad,
    AbstractCoordinateLoad,
    Action,
    Effect,
    MarkerMotion,
)
from jaxclear.ground.arguments import expect
from jaxclear.ground.given_functions import asked, shape_of
from jaxclear.ground.pose import Pose
from jaxclear.ground.quantity import is_one_number, is_traced

__all__ = ["check_own_drive", "check_own_load", "is_own"]

NUMBER = jax.ShapeDtypeStruct((), jnp.float64)
VECTOR = (NUMBER,) * 3
SEEN = MarkerMotion(Pose((VECTOR,) * 3, VECTOR), VECTOR, VECTOR)
ON_COORDINATE = ("generalised force", "stored energy", "dissipated power", "external power")
MOTION = ("position", "speed", "acceleration")
# Instants [s] at which rates are looked at, which no period divides; and how near they are.
INSTANTS, CLOSE = (0.0137, 0.113, 0.371), 1e-6


def check_own_drive(name: str, drive: AbstractDrive | None) -> None:
    """Raises `ValueError` with a sentence where the drive of a joint answers something else than
    its motion."""
    if drive is not None and is_own(drive):
        what = f'the drive of joint "{name}", its motion(time),'
        shape_of(lambda time: _numbers(what, asked(what, drive.motion, time), MOTION), NUMBER)
        if not is_traced(drive):
            _check_rates(name, drive)


def _check_rates(name: str, drive: AbstractDrive) -> None:
    """Raises `ValueError` where the speed of a drive is not the rate of its position, or its
    acceleration not that of its speed, at any of a few instants."""
    motion = lambda time: tuple(jnp.asarray(own, float) for own in drive.motion(time))
    looks = [jax.jvp(motion, (time,), (1.0,)) for time in INSTANTS]
    for below, above in itertools.pairwise(range(3)):
        rates = [(float(found[above]), float(rate[below])) for found, rate in looks]
        if all(abs(told - rate) > CLOSE * (abs(told) + abs(rate)) for told, rate in rates):
            (told, rate), time = rates[0], INSTANTS[0]
            raise ValueError(
                f'the drive of joint "{name}", its motion(time), returns the {MOTION[above]} '
                f"{told:.6g} at {time:g} s, where its {MOTION[below]} changes by {rate:.6g} a "
                "second; each must be the rate of the one before."
            )


def check_own_load(name: str, load: Any) -> None:
    """The same of a load and its effect, or force."""
    if not is_own(load):
        return
    if isinstance(load, AbstractCoordinateLoad):
        what = f'load "{name}", its force(time, position, speed),'
        told = lambda *at: _numbers(what, asked(what, load.force, *at), ON_COORDINATE)
        shape_of(told, NUMBER, NUMBER, NUMBER)
    if isinstance(load, AbstractBodyLoad):
        what, markers = f'load "{name}", its effect(time, motions),', load.markers()
        told = lambda *at: _effect(what, asked(what, load.effect, *at), len(markers))
        shape_of(told, NUMBER, (SEEN,) * len(markers))


def is_own(part: Any) -> bool:
    """Whether a part is of a class from outside this package."""
    return type(part).__module__.partition(".")[0] != __name__.partition(".")[0]


def _effect(what: str, effect: Any, markers: int) -> None:
    expect(effect, Effect, f"{what} returns what", "a jaxclear.load.Effect")
    if len(effect.actions) != markers:
        raise ValueError(
            f"{what} returns {len(effect.actions)} actions; its {markers} markers need one each, "
            "in their order, of zeros where nothing acts."
        )
    for action in effect.actions:
        expect(action, Action, f"{what} returns an action that", "a jaxclear.load.Action")
        _numbers(f"{what} an action's force,", action.force, "xyz")
        _numbers(f"{what} an action's torque,", action.torque, "xyz")
    _numbers(what, effect[1:], Effect._fields[1:])


def _numbers(what: str, found: Any, names: Any) -> None:
    """Raises `ValueError` where what was found is not one number for each name."""
    several = isinstance(found, (tuple, list)) or getattr(found, "ndim", 0) == 1
    parts = list(found) if several else [found]
    if len(parts) != len(names) or not all(map(is_one_number, parts)):
        count = len(parts) if all(map(is_one_number, parts)) else "no"
        raise ValueError(
            f"{what} returns {count} number{'s' * (count != 1)}; it must return {len(names)}: "
            f"{', '.join(names)}."
        )
