"""Which mechanisms are attacked: every builder with laws that take turns, so that each member of
each family acts in several of them.
"""

from typing import NamedTuple

import numpy as np

from benchmarks.attacks import bearings, ideal
from benchmarks.attacks.bearings import Build, Case, Laws
from benchmarks.attacks.coupled import COUPLED
from benchmarks.attacks.laws import CONTACTS, CYLINDERS, FRICTIONS, WEARS
from benchmarks.attacks.numbers import Draw
from benchmarks.attacks.rungs import ALWAYS, LAST, TAKING_TURNS

# Builders with how many structures each gets; the first of each row is the plainest.
WITH_CLEARANCE: tuple[tuple[Build, int], ...] = (
    (bearings.loaded_bearing, 5),
    (bearings.creeping_bearing, 3),
    (bearings.thrown_journal, 3),
    (bearings.pendulum, 2),
    (bearings.double_pendulum, 1),
    (bearings.slider_crank, 3),
    (bearings.slider_crank_of_two, 1),
    (bearings.torque_crank, 1),
    (bearings.four_bar, 1),
    (bearings.four_bar_in_space, 1),
    (bearings.rotating_guide, 1),
    (bearings.pushed_slider, 2),
    (bearings.ball_in_socket, 2),
    (bearings.ball_pendulum, 1),
    (bearings.rotor, 1),
)
IDEAL: tuple[Build, ...] = (
    ideal.damped_chain,
    ideal.sprung_chain,
    ideal.bob_on_spring,
    ideal.ideal_slider_crank,
    ideal.projected_slider_crank,
    ideal.ideal_four_bar,
    ideal.free_slider_crank,
    ideal.tumbling_body,
    ideal.spatial_chain,
    ideal.shaken_slide,
)
# Cylinders' laws know journals; a ball or a corner takes another in their place.
NOT_CYLINDERS = (
    bearings.rotating_guide,
    bearings.pushed_slider,
    bearings.ball_in_socket,
    bearings.ball_pendulum,
)
WITHOUT_WEAR = (bearings.rotating_guide, bearings.pushed_slider)
# Draws of a structure that are made unasked, and room for all that may be, in the numbers of cases.
DRAWS, ROOM = 10, 100
# The seeds of choices and of numbers.
CHOICES, NUMBERS = 1, 2
MODULUS_OF_A_BALL = "ModifiedFlores"


class Structure(NamedTuple):
    """A builder, its laws by name ("": none), the rungs it is run on, and whether it keeps its
    energy balance."""

    number: int
    build: Build
    contact: str
    friction: str
    wear: str
    rungs: tuple[str, ...]
    balance: bool

    @property
    def name(self) -> str:
        """Builder and laws in words."""
        laws = [law for law in (self.contact, self.friction, self.wear) if law]
        return ", ".join([self.build.__name__.replace("_", " "), *laws])

    def case(self, draw: int) -> Case:
        """The mechanism with its numbers of one draw; draw 0 takes the usual ones."""
        laws = Laws(
            CONTACTS.get(self.contact, CONTACTS["Hertz"]),
            FRICTIONS.get(self.friction),
            WEARS.get(self.wear),
        )
        return self.build(Draw(NUMBERS, self.number, draw, plain=draw == 0), laws)


def structures() -> list[Structure]:
    """All of them, in an order in which kinds alternate."""
    shuffled = np.random.default_rng(CHOICES)
    contacts = list(shuffled.permutation(list(CONTACTS)))
    frictions = list(shuffled.permutation([*FRICTIONS, ""]))
    wears = [*WEARS, "Archard", ""]
    builders = [build for build, count in WITH_CLEARANCE for _ in range(count)]
    found = []
    for number, build in enumerate([*builders, *IDEAL, *COUPLED]):
        ideal_one = number >= len(builders)
        contact = str(contacts[number % len(contacts)])
        if build in NOT_CYLINDERS and contact in CYLINDERS:
            contact = MODULUS_OF_A_BALL
        wear = "" if build in WITHOUT_WEAR else wears[number % len(wears)]
        turn = TAKING_TURNS[number % len(TAKING_TURNS)]
        friction = str(frictions[number % len(frictions)])
        laws = ("", "", "") if ideal_one else (contact, friction, wear)
        found.append(Structure(number, build, *laws, (*ALWAYS, turn, *LAST), number % 3 != 2))
    return found
