"""Lines of a drawing as free numbers of a design: the classes of a fit, whose mean sizes follow the
class, and the size of a zone, which all numbers of the zone share.
"""

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxclear.ground.arguments import check_name, expect
from jaxclear.studies.design.catalogue import Fits
from jaxclear.studies.design.question import TOLERANCE, Choice, choice_of, usual_tolerance
from jaxclear.studies.tolerance.drawing import Bonus, ZoneVariable
from jaxclear.studies.tolerance.fit import HOLE, SHAFT, Fit, FitSizes

# Limits of size closer than this are one [m].
SAME_LIMIT = 1e-12


def line_choices(problem: Any, choose: Any) -> list[Choice]:
    """The free numbers of lines of a drawing. Raises `ValueError` with a sentence for what cannot
    be chosen."""
    what = "a dictionary from names of lines of a drawing"
    expect(choose or {}, Mapping, "choose of design", what)
    choices: list[Choice] = []
    for name, options in (choose or {}).items():
        check_name("line", name, problem.variable_names, " in this problem")
        line = problem.variables[name]
        what = "a fit or a zone of a drawing; give it as `tolerance` or `nominal`"
        expect(line, (FitSizes, ZoneVariable), f'line "{name}" in choose of design', what)
        if isinstance(line, FitSizes):
            choices += _fit_choices(problem, name, line, options)
        else:
            choices.append(_zone_choice(problem, name, line, options))
    return choices


def cost_by_number(problem: Any, choose: Any, cost: Any) -> Any:
    """Costs of a drawing's lines by the first of their numbers, instead of by the line's name.

    Args:
        problem: groups the numbers of a line under its name.
        choose: lines that a user leaves open, by name; None: none.
        cost: by name; anything but a mapping is returned unchanged.
    """
    if not isinstance(cost, Mapping):
        return cost
    first = {name: problem.names[problem.groups[name][0]] for name in choose or {}}
    return {first.get(name, name): price for name, price in cost.items()}


def _fit_choices(problem: Any, name: str, line: FitSizes, classes: Any) -> list[Choice]:
    what = 'a jaxclear.catalogue.Fits, such as Fits("H6..H8/g5..g7")'
    expect(classes, Fits, f'what may be chosen of the fit "{name}"', what)
    drawn, choices = line.fit.classes, []
    for pair in itertools.product(classes.holes, classes.shafts):
        line.fit.with_classes(*pair).check_clearance(name)
    for side, codes in enumerate((classes.holes, classes.shafts)):
        if len(codes) == 1:
            where = " on the drawing (offer it, or a range)"
            check_name(f'single class of "{name}"', codes[0], drawn, where)
            continue
        pairs = [(code, drawn[1]) if side == 0 else (drawn[0], code) for code in codes]
        fits = [line.fit.with_classes(*pair) for pair in pairs]
        halves = tuple(0.5 * float(np.ptp(fit.limits(side))) for fit in fits)
        means = tuple(float(fit.sizes(name).means[side]) for fit in fits)
        for zone, other in problem.variables.items():
            _check_bonus(zone, getattr(other, "bonus", None), (name, side), fits)
        column, usual = problem.groups[name][side], 0.5 * float(np.ptp(line.fit.limits(side)))
        choice = Choice(TOLERANCE, column, halves[0], halves[-1], halves, codes)
        choices.append(choice._replace(nominals=means, usual=usual))
    return choices


def _check_bonus(zone: str, bonus: Bonus | None, feature: tuple[str, int], fits: list[Fit]) -> None:
    """Raises `ValueError` where the size from which a zone grows depends on the class."""
    if bonus is None or (bonus.joint, bonus.side) != (feature[0], (HOLE, SHAFT)[feature[1]]):
        return
    sizes = [fit.size + fit.limits(feature[1])[bonus.sign < 0] for fit in fits]
    if not np.allclose(sizes, bonus.limit, rtol=0.0, atol=SAME_LIMIT):
        raise ValueError(
            f'zone "{zone}" grows from a limit of "{bonus.joint} {bonus.side}" that depends on the '
            "class; take the material condition whose limit all classes share."
        )


def _zone_choice(problem: Any, name: str, line: ZoneVariable, span: Any) -> Choice:
    if line.bonus is not None or isinstance(line.zone.size, tuple):
        raise ValueError(
            f'zone "{name}" cannot be chosen; give it one size, without a material condition.'
        )
    first, *others = problem.groups[name]
    usual = usual_tolerance(problem.inputs.distributions[first])
    choice, ratio = choice_of(TOLERANCE, name, first, span), usual / float(line.zone.size)
    low, high, *offered = (ratio * size for size in (choice.low, choice.high, *choice.offered))
    return choice._replace(low=low, high=high, offered=tuple(offered), others=tuple(others))
