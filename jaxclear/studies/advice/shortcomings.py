"""What is wrong with a method that is not recommended, in words."""

from jaxclear.studies import verdict
from jaxclear.studies.advice.pilot import Trial, describe
from jaxclear.studies.verdict import Criterion, MeasuredError

# Errors that shorter steps change by less than this share of themselves are not the steps'.
SETTLED = 0.05
OF_ITS_MODEL = "Shorter steps leave it so: that is its model of contact, which is another one."


def shortcoming(finished: list[Trial], criteria: dict[str, Criterion]) -> str:
    """The best of a method's trials, none of which meets the accuracy, in a sentence."""
    undecided = [trial for trial in finished if verdict.undecided(trial, criteria)]
    best = min(undecided or finished, key=lambda trial: verdict.worst(trial, criteria)[1])
    which, error = worst_of(best, criteria)
    text = f'{in_percent(error)} in "{which}" with {describe(best.integrator)}'
    if undecided:
        copies = verdict.copies_to_decide(best, criteria)
        return f"undecided: {text}; some {copies} copies would tell."
    model = OF_ITS_MODEL if _is_of_its_model(finished, criteria[which], which) else ""
    return f"too inaccurate: {text}. {model}".rstrip()


def _is_of_its_model(finished: list[Trial], criterion: Criterion, which: str) -> bool:
    """Whether a response is off by as much however short the steps are, of trials of rigid contact
    or of joints that always touch."""
    if len(finished) < 2 or not finished[-1].integrator.formulation.forces_are_means:
        return False
    last, finer = (verdict.error_of(one.responses[which], criterion) for one in finished[-2:])
    return abs(last.error - finer.error) <= SETTLED * finer.error and sum(finer) > criterion.limit


def worst_of(trial: Trial, criteria: dict[str, Criterion]) -> tuple[str, MeasuredError]:
    """The response that is nearest to its limit or furthest beyond, and its error."""
    which = verdict.worst(trial, criteria)[0]
    return which, verdict.error_of(trial.responses[which], criteria[which])


def in_percent(error: MeasuredError) -> str:
    """An error with its uncertainty, in words."""
    return f"{percent(error.error)} +- {percent(error.uncertainty)}"


def percent(share: float) -> str:
    """A share, in words."""
    return f"{100 * share:.2g} %" if share < 1 else f"{100 * share:.3g} %"
