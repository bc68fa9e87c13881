"""A scene: a mechanism with how it is run, or at which positions it stands, and, where it says so,
what varies of it and which responses are wanted.
"""

from collections.abc import Mapping
from typing import Any

import equinox as eqx

from jaxclear.ground.arguments import check_flags, check_known, expect
from jaxclear.ground.quantity import AbstractQuantified
from jaxclear.ground.wording import listed
from jaxclear.integrators import AbstractIntegrator
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.results.positions import Positions
from jaxclear.results.saved_state import State
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.positions import checked_positions, positions
from jaxclear.simulation.seated import seated
from jaxclear.simulation.simulate import check_duration, simulate
from jaxclear.studies.mechanism_problem import by_name
from jaxclear.studies.position_problem import PositionProblem
from jaxclear.studies.problem import Problem

__all__ = ["Scene"]

SEATED = "seated"


class Scene(AbstractQuantified):
    """A mechanism, how it is run, and what is asked of it: what a scene file holds.

    Either a run over time: `duration` [s]; `integrator`, `save` and `state` as of `simulate` and
    `Problem`, their own defaults where None; `state` may be the word "seated" for a start at which
    journals lie as `jaxclear.seated` says. Or `positions` [rad, m] by joint, without time, and
    `both_ways`, as of `jaxclear.positions` and `PositionProblem`. `variables` and `responses` by
    name, and `correlation`, are those of the problem. `jaxclear.read_scene` and
    `jaxclear.write_scene` keep it as a file. Raises `ValueError` with a sentence for what is none
    of these.
    """

    mechanism: Mechanism
    duration: Any = None
    integrator: AbstractIntegrator | None = None
    save: Any = None
    state: State | str | None = None
    variables: Any = eqx.field(default_factory=dict)
    responses: Any = eqx.field(default_factory=dict)
    correlation: Any = None
    description: str = ""
    positions: Any = None
    both_ways: bool = False

    def __check_init__(self):
        check_flags("Scene", both_ways=self.both_ways)
        if self.positions is not None:
            checked_positions(self.positions)
            timed = ("duration", "integrator", "save", "state")
            given = [name for name in timed if getattr(self, name) is not None]
            if given:
                raise ValueError(
                    f"a Scene is given positions and {listed(given)}; it is a mechanism over "
                    "positions, without time, or a run: give one of the two."
                )
        elif self.both_ways:
            raise ValueError("a Scene is given both_ways without positions, to which it belongs.")
        if self.duration is not None:
            check_duration(self.duration)
        if isinstance(self.state, str):
            check_known("start of a Scene, beside a jaxclear.State", self.state, [SEATED])
        by_name("variables", self.variables)
        expect(self.responses, Mapping, "responses of a Scene", "a dictionary from names")

    def _shown(self):
        """What it is of, how it is run, and what is asked of it."""
        known = self.mechanism
        lines = [f"Scene{f': {self.description}' if self.description else ''}"]
        for part in ("bodies", "connections", "loads", "couplings"):
            lines += [f"  {part} {', '.join(getattr(known, part))}"] if getattr(known, part) else []
        told = {
            "duration": None if self.duration is None else f"{float(self.duration):.6g} s",
            "positions of": self.positions and ", ".join(self.positions),
            "integrator": self.integrator,
            "state": self.state,
            "variables": ", ".join(self.variables),
            "responses": ", ".join(self.responses),
        }
        return "\n".join([*lines, *(f"  {what} {own}" for what, own in told.items() if own)])

    def simulate(
        self,
        *,
        balance: bool = False,
        progress_bar: bool = False,
        throw: bool = True,
        verify: bool | None = None,
    ) -> Trajectory:
        """The run that the scene describes; arguments and errors as of `jaxclear.simulate`."""
        if self.positions is not None:
            raise ValueError(
                "this scene states positions, without time: ask scene.stand(), or give it a "
                "duration [s] in their place."
            )
        given = self._given()
        flags: dict[str, Any] = {"balance": balance, "progress_bar": progress_bar, "throw": throw}
        flags["verify"] = verify
        return simulate(self.mechanism, integrator=self.integrator, **given, **flags)

    def stand(self) -> Positions:
        """The mechanism at the positions that the scene states, as `jaxclear.positions` has it."""
        if self.positions is None:
            raise ValueError("this scene states no positions; give it some, or ask for its run.")
        return positions(self.mechanism, self.positions, both_ways=self.both_ways)

    def problem(self) -> Problem | PositionProblem:
        """The question that the scene asks. Raises `ValueError` where it lacks variables or
        responses."""
        for what, own in (("variables", self.variables), ("responses", self.responses)):
            if not own:
                raise ValueError(f"this scene states no {what}; a problem needs some.")
        asked = (self.mechanism, dict(self.responses), dict(self.variables))
        more: dict[str, Any] = {"correlation": self.correlation}
        if self.positions is not None:
            more |= {"positions": self.positions, "both_ways": self.both_ways}
            return PositionProblem(*asked, **more)
        more |= {"integrator": self.integrator, **self._given()}
        return Problem(*asked, **more)

    def _given(self) -> dict[str, Any]:
        """What `simulate` and `Problem` are given alike."""
        if self.duration is None:
            raise ValueError("this scene states no duration and no positions; give it one [s].")
        state = seated(self.mechanism) if self.state == SEATED else self.state
        given: dict[str, Any] = {"duration": self.duration, "state": state}
        return given if self.save is None else given | {"save": self.save}
