"""The integrator of a study: for an accuracy of its responses, chosen once, from runs of the
nominal sample, so that all samples are run alike. Unasked the first guess is taken
(`usual_integrator`), which costs no run, unless it takes so many steps that a choice pays.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from jaxclear.errors.accuracy import checked_accuracy, ratio_to_allowed
from jaxclear.errors.choice import Chosen
from jaxclear.ground.arguments import check_name
from jaxclear.ground.quantity import on_host
from jaxclear.integrators import AbstractIntegrator
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.native.compiled import AROUND_A_KERNEL, compiled_quickly
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.simulate import How, chosen_for
from jaxclear.studies.responses import answer
from jaxclear.studies.usual_integrator import usual_integrator

# Steps of a guess beyond which runs choose in its place, and the accuracy for which they do: a
# hundred such runs take longer than the choice compiles.
DEAR, UNASKED = 200_000, 0.02
# A share of every response, or numbers in units by name.
Goal = float | tuple[tuple[str, float], ...]


def chosen_integrator(
    mechanism: Mechanism, response: Mapping[str, Callable], duration: Any, target: Goal, how: How
) -> Chosen:
    """The integrator with which every response is as accurate as required, at the least work.

    Args:
        mechanism: the nominal one.
        response: functions of a run, by name.
        duration: of a run [s].
        target: a share of each response's size in the nominal sample [1], or numbers in units
            by name.
        how: settings of the run.

    Raises:
        ValueError: no integrator suits the mechanism.
    """
    all_of = lambda run: {name: answer(name, function, run) for name, function in response.items()}
    drawn = compiled_quickly(all_of, AROUND_A_KERNEL)

    def compare(run: Trajectory, one: dict, other: dict) -> dict[str, float]:
        limits = {name: allowed(target, name) for name in response}
        return {
            name: ratio_to_allowed(
                abs(one[name] - other[name]), max(most[0], most[1] * abs(one[name]))
            )
            for name, most in limits.items()
            if most is not None
        }

    observe = lambda run: {name: float(np.asarray(x)) for name, x in drawn(run).items()}
    return chosen_for(mechanism, duration, observe, compare, how)


def unasked(
    mechanism: Mechanism, response: Mapping[str, Callable], duration: Any, how: How
) -> tuple[AbstractIntegrator, str, Goal | None]:
    """The integrator of a study without a request, why, and the accuracy for which it was chosen.

    The last is None where it was not chosen by runs.

    Args:
        mechanism: the nominal one.
        response: functions of a run, by name.
        duration: of a run [s].
        how: settings of the run.
    """
    usual, why = usual_integrator(mechanism, duration)
    step = on_host(usual.requested_step())
    if not why or step is None or duration <= DEAR * step:
        return usual, why, None
    choice = chosen_integrator(mechanism, response, duration, UNASKED, how)
    return (choice.integrator, choice.why, UNASKED) if choice.reached else (usual, why, None)


def allowed(accuracy: Goal, response: str) -> tuple[float, float] | None:
    """The largest error that is asked of a response, in its unit and as a share of its size (the
    larger of the two counts); None: any."""
    if isinstance(accuracy, float):
        return 0.0, accuracy
    value = dict(accuracy).get(response)
    return None if value is None else (value, 0.0)


def required_accuracy(accuracy: Any, response: Mapping[str, Callable]) -> Goal:
    """What a problem is asked of its responses. Raises `ValueError` with a sentence."""
    checked = checked_accuracy(accuracy, "a Problem")
    if isinstance(checked, float):
        return checked
    for name in checked:
        check_name("response", name, response, " in this problem")
    return tuple(checked.items())
