"""A scene: a mechanism with how it is run and, where it says so, what varies of it and which
responses are wanted.
"""

from collections.abc import Mapping
from typing import Any

import equinox as eqx

from jaxclear.ground.arguments import check_known, expect
from jaxclear.ground.quantity import AbstractQuantified
from jaxclear.integrators import AbstractIntegrator
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.results.saved_state import State
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.seated import seated
from jaxclear.simulation.simulate import check_duration, simulate
from jaxclear.studies.problem import Problem
from jaxclear.studies.responses import by_name

__all__ = ["Scene"]

SEATED = "seated"


class Scene(AbstractQuantified):
    """A mechanism, how it is run, and what is asked of it: what a scene file holds.

    `duration` [s]; `integrator`, `save` and `state` as of `simulate` and `Problem`, their own
    defaults where None; `state` may be the word "seated" for a start at which journals lie as
    `jaxclear.seated` says. `variables` and `responses` by name, and `correlation`, are those of a
    `Problem`. `jaxclear.read_scene` and `jaxclear.write_scene` keep it as a file. Raises
    `ValueError` with a sentence for what is none of these.
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

    def __check_init__(self):
        if self.duration is not None:
            check_duration(self.duration)
        if isinstance(self.state, str):
            check_known("start of a Scene, beside a jaxclear.State", self.state, [SEATED])
        by_name("variables", self.variables)
        expect(self.responses, Mapping, "responses of a Scene", "a dictionary from names")

    def simulate(
        self, *, balance: bool = False, progress_bar: bool = False, throw: bool = True
    ) -> Trajectory:
        """The run that the scene describes; arguments and errors as of `jaxclear.simulate`."""
        given = self._given()
        flags = {"balance": balance, "progress_bar": progress_bar, "throw": throw}
        return simulate(self.mechanism, integrator=self.integrator, **given, **flags)

    def problem(self) -> Problem:
        """The question that the scene asks. Raises `ValueError` where it lacks variables or
        responses."""
        for what, own in (("variables", self.variables), ("responses", self.responses)):
            if not own:
                raise ValueError(f"this scene states no {what}; a problem needs some.")
        return Problem(
            self.mechanism,
            dict(self.responses),
            dict(self.variables),
            integrator=self.integrator,
            correlation=self.correlation,
            **self._given(),
        )

    def _given(self) -> dict[str, Any]:
        """What `simulate` and `Problem` are given alike."""
        if self.duration is None:
            raise ValueError("this scene states no duration; give it one [s].")
        state = seated(self.mechanism) if self.state == SEATED else self.state
        given: dict[str, Any] = {"duration": self.duration, "state": state}
        return given if self.save is None else given | {"save": self.save}
