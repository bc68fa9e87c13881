"""A sample that a study is given instead of drawing one: a Monte Carlo study or a campaign, of the
same problem, or its numbers would be another's.
"""

from jaxclear.studies.base import AbstractProblem
from jaxclear.studies.campaign.result import Campaign
from jaxclear.studies.identity import first_difference
from jaxclear.studies.monte_carlo import MonteCarlo

__all__ = ["GivenSample", "given_sample"]

GivenSample = MonteCarlo | Campaign


def given_sample(problem: AbstractProblem, sample: GivenSample) -> MonteCarlo:
    """The sample in memory. Raises `ValueError` with a sentence for one of another problem."""
    if isinstance(sample, Campaign):
        return sample.sample_of(problem)
    difference = first_difference(sample.problem, problem)
    if difference:
        raise ValueError(
            f"the sample is of another problem ({difference}); give a sample of this one, "
            "jaxclear.monte_carlo(problem), or how many samples to draw."
        )
    return sample
