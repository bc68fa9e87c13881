"""Which studies a campaign keeps beside Monte Carlo, and how each is asked."""

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

from jaxclear.ground.arguments import expect
from jaxclear.ground.wording import described, listed
from jaxclear.studies.base import AbstractProblem
from jaxclear.studies.design.design import design
from jaxclear.studies.ledger.ledger import Ledger, current
from jaxclear.studies.ledger.pieces import checked_folder
from jaxclear.studies.life.lives import wear_lives
from jaxclear.studies.life.wear_life import wear_life
from jaxclear.studies.reliability.reliability import reliability
from jaxclear.studies.sensitivity.sensitivity import sensitivity
from jaxclear.studies.statistics.shapley import shapley_effects
from jaxclear.studies.statistics.sobol_indices import sobol_indices
from jaxclear.studies.surface.surface import surface
from jaxclear.studies.texts import in_texts
from jaxclear.studies.worst_case import worst_case

# What they keep, in words. Some keep records of their own; of others all samples are kept.
OWN_RECORDS = {wear_life: "a wear life", wear_lives: "wear lives", design: "a design"}
BY_SAMPLES = {
    sensitivity: "a sensitivity study",
    sobol_indices: "a study of Sobol' indices",
    surface: "a response surface",
    worst_case: "a worst case",
    reliability: "a reliability",
    shapley_effects: "a study of Shapley effects",
}
# What keeps lives, in words.
OTHERWISE = (
    "is no compiled program, and a campaign keeps samples of one; ask jaxclear.monte_carlo for "
    "lives as responses, or jaxclear.wear_lives(..., store=folder) for lives that are kept."
)
# How studies call the number of their samples.
COUNTS = ("samples", "sample")


def kept_study(
    study: Any,
    problem: AbstractProblem,
    folder: Any,
    given: dict[str, Any],
    settings: dict[str, Any],
) -> Any:
    """What a study answers, from a folder as far as it is there. `given`: arguments of the campaign
    that the study may have, absent where None. Raises `ValueError` with a sentence for a study that
    is not kept, or an argument that it has not."""
    if not callable(study) or study not in OWN_RECORDS | BY_SAMPLES:
        known = [f"jaxclear.{own.__name__}" for own in OWN_RECORDS | BY_SAMPLES]
        raise ValueError(
            f"study of campaign is {described(study)}; it must be one of {listed(known)}, or left "
            "out for a Monte Carlo study."
        )
    settings = settings | _named(study, {n: own for n, own in given.items() if own is not None})
    if study in BY_SAMPLES:
        refuse_uncompiled(problem)
    path: Path = checked_folder(folder)
    try:
        if study in OWN_RECORDS:
            return study(problem, store=path, **settings)
        expect(problem, AbstractProblem, "problem of campaign", "a jaxclear.Problem")
        with current(Ledger.opened(path, BY_SAMPLES[study], in_texts(problem))):
            return study(problem, **settings)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"The study was interrupted. What it had computed is kept in {path}; ask the same "
            "again, and it goes on from there."
        ) from None


def refuse_uncompiled(problem: Any) -> None:
    """Raises `ValueError` with a sentence for a problem whose samples are no compiled program. What
    is no problem at all is for its study to refuse."""
    if isinstance(problem, AbstractProblem) and not problem.compiled():
        raise ValueError(f"problem of campaign ({type(problem).__name__}) {OTHERWISE}")


def _named(study: Callable, given: dict[str, Any]) -> dict[str, Any]:
    """What is given, by the names that the study has for it."""
    takes = inspect.signature(study).parameters
    found = {}
    for name, value in given.items():
        known = [own for own in (COUNTS if name == "samples" else (name,)) if own in takes]
        if not known:
            raise ValueError(
                f"jaxclear.{study.__name__} has no {name}; leave it out of the campaign."
            )
        found[known[0]] = value
    return found
