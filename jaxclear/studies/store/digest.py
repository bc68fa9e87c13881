"""A problem in texts, one for each of its parts: two problems are the same where these are, also in
another process, and where one of them lies in a folder.
"""

from jaxclear.ground.description import FUNCTION, describe
from jaxclear.ground.wording import listed
from jaxclear.studies.problem import Problem


def in_texts(problem: Problem) -> dict[str, str]:
    """A text for each part of a problem, by its path. Numbers with all their digits, large arrays
    and functions by a digest."""
    parts = problem.parts()
    parts |= {
        f'distribution of "{name}"': problem.variables[name].distribution
        for name in problem.variable_names
    }
    if problem.correlation is not None:
        parts["correlation of the variables"] = problem.correlation
    return describe(parts.items())


def difference(one: Problem, other: Problem) -> str:
    """The first thing in which `one` differs from `other`, in words; "" where they are the same. A
    problem built anew by the same lines is the same."""
    for kind in ("names", "response_names"):
        mine, others = getattr(one, kind), getattr(other, kind)
        if mine != others:
            what = "variables" if kind == "names" else "responses"
            return f"its {what} are {listed(mine) or 'none'}, not {listed(others) or 'none'}"
    mine, others = type(one.experiment), type(other.experiment)
    if mine is not others:
        return f"it is of a {mine.__name__}, not of a {others.__name__}"
    return first_difference(in_texts(one), in_texts(other))


def first_difference(one: dict[str, str], other: dict[str, str]) -> str:
    """The first part in which two descriptions differ, in words; "" where they are the same."""
    for part in one | other:
        mine, others = one.get(part, "absent"), other.get(part, "absent")
        if mine != others:
            if mine.startswith(FUNCTION) and others.startswith(FUNCTION):
                return f"{part} is another function"
            return f"{part} is {mine} there, {others} here"
    return ""
