"""The integrator of a study that asks for an accuracy of its responses: chosen once, from runs of
the nominal sample, so that all samples of a study are run alike.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from jaxclear.errors.accuracy import beside, checked_accuracy
from jaxclear.errors.choice import Chosen
from jaxclear.ground.arguments import check_known
from jaxclear.ground.compiling import AROUND_A_KERNEL, compiled_quickly
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.simulate import How, chosen_for

# A share of every response, or numbers in units by name.
Wanted = float | tuple[tuple[str, float], ...]


def chosen_integrator(
    mechanism: Mechanism,
    response: Mapping[str, Callable],
    duration: float,
    asked: Wanted,
    how: How,
) -> Chosen:
    """The integrator by which every response of a mechanism is as accurate as is `asked`, a share
    of its size in the nominal sample or numbers in units by name, at the least work. Raises
    `ValueError` with a sentence for what cannot be chosen."""
    drawn = compiled_quickly(
        lambda run: {name: own(run) for name, own in response.items()}, AROUND_A_KERNEL
    )

    def apart(run: Trajectory, one: dict, other: dict) -> dict[str, float]:
        if isinstance(asked, float):
            allowed = {name: asked * abs(one[name]) for name in response}
        else:
            allowed = dict(asked)
        return {n: beside(abs(one[n] - other[n]), most) for n, most in allowed.items()}

    seen = lambda run: {name: float(np.asarray(x)) for name, x in drawn(run).items()}
    return chosen_for(mechanism, duration, seen, apart, how)


def checked_asked(accuracy: Any, response: Mapping[str, Callable]) -> Wanted:
    """What a problem is asked of its responses. Raises `ValueError` with a sentence."""
    asked = checked_accuracy(accuracy, "a Problem")
    if isinstance(asked, float):
        return asked
    for name in asked:
        check_known("response", name, response, " in this problem")
    return tuple(asked.items())
