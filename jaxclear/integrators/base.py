"""How a state is carried from one saving time to the next: what every integrator is asked, and how
it answers.

An integrator holds a formulation, which knows how contact enters the equations of motion, and sees
a `Model` (the mechanism) and an interval. Outcomes are numbers while the program runs and sentences
when a user reads them.
"""

from abc import abstractmethod
from typing import Any, NamedTuple

import equinox as eqx
from jaxtyping import Array, Bool, Float, Int

from jaxclear.formulations.base import AbstractFormulation
from jaxclear.formulations.model import Model, State
from jaxclear.ground.quantity import AbstractQuantified, Scalar
from jaxclear.integrators.events import Events
from jaxclear.integrators.peaks import Peaks
from jaxclear.integrators.promise import IMPLICIT, Promise
from jaxclear.multibody.mechanism import Mechanism


class Interval(NamedTuple):
    """From one saving time `start` [s] to the next, `stop` [s].

    `error_weights` scale each entry's error for an error control; 0 where an entry only follows the
    others. Where `running` is False the run has ended before and the outcome will be ignored: an
    integrator may then save the work. `peaks`: the largest indentations [m] and forces [N] of the
    run so far (None: not followed), for their derivatives.
    """

    start: Scalar
    stop: Scalar
    error_weights: Float[Array, " n"]
    running: Bool[Array, ""]
    peaks: Peaks | None = None


class Advance(NamedTuple):
    """Outcome of one interval: state at its end, steps accepted and rejected, what helps the next
    interval to start, `Outcome`; the `peaks` of every possible contact in the interval (None:
    nothing follows them); `events`: touches and releases, where the model asks for them."""

    state: State
    accepted: Int[Array, ""]
    rejected: Int[Array, ""]
    warm_start: Any
    outcome: Int[Array, ""]
    peaks: Peaks | None = None
    events: Events | None = None


class AbstractIntegrator(AbstractQuantified):
    """Carries a state over an interval.

    `pathwise`: whether forward-mode derivatives through its steps are those of the discrete run
    (where contacts open and close, not those of the motion). `projects`: whether loops can be
    closed anew after its steps.
    """

    pathwise: eqx.AbstractClassVar[bool]
    projects: eqx.AbstractClassVar[bool]

    @property
    @abstractmethod
    def formulation(self) -> AbstractFormulation:
        """How contact enters the equations."""

    @abstractmethod
    def first_warm_start(self, model: Model, start: Scalar, state: State) -> Any:
        """What the first interval is handed in place of what an interval before it left."""

    @abstractmethod
    def advance(self, model: Model, interval: Interval, state: State, warm_start: Any) -> Advance:
        """The state at the end of an interval; `warm_start` is what the last interval left to this
        one."""

    def known_states(
        self,
        model: Model,
        times: Float[Array, " saves"],
        states: Float[Array, "saves n"],
        end: State,
        warm_start: Any,
    ) -> Float[Array, "saves n"]:
        """The states of a run at its saving times [s], their derivatives nan where only the state
        in which it has ended tells that they are not known; `warm_start`: what it has left."""
        return states

    @property
    def opens_loops(self) -> bool:
        """Whether its steps open loops by more than rounding, so that it closes them anew after
        each where a mechanism does not say how its loops are held."""
        return False

    def asked_step(self) -> Scalar | None:
        """The longest step [s] that was asked for; None where nobody asked for one."""
        return None

    def evaluations(self, mechanism: Mechanism) -> int:
        """How often a step asks for the forces in a mechanism, as far as it knows."""
        return 1

    def shortest_step(self) -> Scalar | None:
        """The shortest step [s] that these numbers lead to, saving times aside."""
        return self.asked_step()

    @property
    def through_contacts(self) -> bool:
        """Whether forward-mode derivatives through its steps are those of the motion where contacts
        open and close too."""
        return False

    def beyond_touches(self, mechanism: Mechanism) -> str:
        """What its derivatives do not know of the contacts of a mechanism; "" where they are those
        of the motion."""
        return "" if self.through_contacts else "how the instants of touch move"

    @property
    def first_order_slopes(self) -> bool:
        """Whether its derivatives are off in proportion to the step, not to its square or less:
        those of steps that have a length are compared with those in other steps."""
        return False

    @property
    def notes_events(self) -> bool:
        """Whether it notes touches and releases of contacts."""
        return False

    @property
    def steps_between_saves(self) -> int | None:
        """Their number, where it is fixed."""
        return None

    @property
    def in_kernels(self) -> bool:
        """Whether its steps can be machine code, as far as it knows."""
        return True

    def with_finer_steps(self, share: Scalar) -> "AbstractIntegrator | None":
        """Itself with steps of this share of their length, or tolerances tighter by its fourth
        power where it finds their length itself; None where they are counted, or as fine as numbers
        allow."""
        return None

    def counting_in(self, gap: Any, arm: Any) -> "AbstractIntegrator":
        """Itself with the numbers that count where the narrowest gap and the longest arm are these
        [m], if those given do not."""
        return self

    @property
    def remedy(self) -> str:
        """What makes the errors of a run by it smaller."""
        return "take shorter steps"

    def held(self, step: Scalar) -> "AbstractIntegrator":
        """Itself with no step longer than this [s], where it finds their length itself."""
        return self

    @property
    def promise(self) -> Promise:
        """The largest errors with which a run by it says nothing of its numbers."""
        return IMPLICIT
