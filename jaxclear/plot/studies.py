"""Figures of studies: spread of responses, derivatives with errors, work against precision.

Figures of what tolerances do to responses: extremes, shares of the variance, means by surfaces
and by models of two kinds, probabilities of failing.
"""

import re
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_name, expect
from jaxclear.ground.printing import as_typed
from jaxclear.plot.canvas import Roomy, as_warnings, key, panels, readable
from jaxclear.studies.advice import PRESENT, Advice
from jaxclear.studies.fidelity.result import MultiFidelity
from jaxclear.studies.monte_carlo import MonteCarlo
from jaxclear.studies.reliability.result import Reliability
from jaxclear.studies.screening import Screening
from jaxclear.studies.sensitivity.derivative import Sensitivity
from jaxclear.studies.statistics.shapley import ShapleyEffects
from jaxclear.studies.statistics.sobol_indices import SobolIndices
from jaxclear.studies.store.result import Campaign
from jaxclear.studies.surface.correction import CorrectedStatistics
from jaxclear.studies.surface.response_surface import ResponseSurface
from jaxclear.studies.sweep import Sweep
from jaxclear.studies.worst_case import WorstCase

# An error as large as the response is drawn no higher, a hundredth of the accuracy no lower.
LARGEST_ERROR, LEAST_ERROR = 1.0, 0.01
DIVERGED = "failed, or no digit right"
EDGE: dict[str, Any] = {"mfc": "none", "ms": 7, "zorder": 4}
# Panels side by side; values of a second variable up to which each has a line; letters in a line of
# a legend.
MOST_COLUMNS, MOST_CURVES, IN_LEGEND = 3, 8, 24
# Where a sentence ends.
SENTENCES = re.compile(r"(?<=[.!?]) +(?=[A-Z0-9])")


@answering
def monte_carlo(study: MonteCarlo | Campaign, *, ax: Any = None) -> Any:
    """Histogram of every response over the sample, with its mean and 5 to 95 % range.

    Args:
        study: a `MonteCarlo` or `Campaign`, as `jaxclear.monte_carlo` or `jaxclear.campaign`
            returns it.
        ax: `matplotlib.axes.Axes` to draw in, one for each response; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `study` is something else.
    """
    study = _samples_in_memory(study)
    names = list(study.responses)
    sheet = panels("monte_carlo", ax, 1, len(names), (4.6 * len(names), 3.8))
    for axis, name in zip(sheet.axes.flat, names, strict=True):
        answers = study.good(name)[0]
        values = answers[np.isfinite(answers)]
        factor, unit = readable(values, study.problem.units()[name])
        axis.hist(factor * values, bins="auto", color="C0", alpha=0.8)
        axis.set_xlabel(f"{name} [{unit}]")
        if len(values) < len(answers):
            # Of infinite answers, as lives may be, there is no mean, and no place on an axis.
            axis.set_xlabel(f"{name} [{unit}], infinite in {len(answers) - len(values)} more")
        else:
            axis.axvline(factor * values.mean(), color="k", lw=1.2, label="mean")
            low, high = np.percentile(factor * values, [5, 95])
            axis.axvspan(low, high, color="C1", alpha=0.25, label="5 to 95 %", zorder=0)
        axis.set_ylabel("samples")
        axis.yaxis.set_major_locator(Roomy(integers=True))
    sheet.legend()
    sheet.title(f"Monte Carlo, {study.count} samples, {len(study.failed)} failed")
    return sheet.done(_warned_samples(study))


def _warned_samples(study: MonteCarlo) -> list[str]:
    """How many samples warn, and what the means are without them."""
    if not len(study.warned) and not study.accuracy_warnings:
        return []
    sentences = as_warnings(study.accuracy_warnings or [study.count_sentence()])
    for row in study.summary().to_dict("records"):
        if row["warned"]:
            values = study.responses[row["response"]]
            factor, unit = readable(values[np.isfinite(values)], row["unit"])
            means = (
                f"the mean is {factor * row['mean']:.4g} with them, "
                f"{factor * row['mean, samples without warnings']:.4g} without [{unit}]."
            )
            if row.get("infinite"):
                means = f"there is no mean, infinite in {row['infinite']} samples."
            sentences += [f"{row['response']}: {row['warned']} in doubt; {means}"]
    return sentences


@answering
def sensitivity(study: Sensitivity, *, ax: Any = None) -> Any:
    """Every derivative by every method, with its 95 % interval.

    A method that refused is named, not drawn.

    Args:
        study: a `Sensitivity`, as `jaxclear.sensitivity` returns it.
        ax: `matplotlib.axes.Axes` to draw in, one for each derivative; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `study` is something else.
    """
    expect(study, Sensitivity, "the study", "what jaxclear.sensitivity returns")
    entries = list(study.derivatives.items())
    same_methods = len({tuple(d.estimates) for _, d in entries}) == 1
    columns = len(entries) if ax is not None else min(len(entries), MOST_COLUMNS)
    rows = -(-len(entries) // columns)
    size = 4.6 * columns, 3.6 * rows
    sheet = panels("sensitivity", ax, rows, columns, size, sharey=same_methods)
    for empty in sheet.axes.flat[len(entries) :]:
        empty.remove()
    rest: dict[str, list[str]] = {}
    for axis, ((response, variable), derivative) in zip(sheet.axes.flat, entries, strict=False):
        answers: dict[str, Any] = {**derivative.estimates, "answer": derivative}
        ends = [abs(one.value) + one.error for one in answers.values()]
        factor, unit = readable(ends, study.unit(response, variable))
        for row, (name, one) in enumerate(answers.items()):
            if np.isfinite(one.value):
                colour = "k" if name == "answer" else "C0"
                error = factor * one.error
                axis.errorbar(
                    factor * one.value, -row, xerr=error, fmt="o", color=colour, capsize=4
                )
            else:
                place: dict[str, Any] = {"transform": axis.get_yaxis_transform(), "color": "C3"}
                axis.text(0.5, -row, "refused", ha="center", va="center", **place)
        axis.set_yticks([-row for row in range(len(answers))], list(answers))
        axis.set_ylim(-len(answers) + 0.4, 0.6)
        axis.axvline(0.0, color="0.7", lw=0.8)
        axis.set_xlabel(f"d({response}) / d({variable}) [{unit}]")
        first, *others = SENTENCES.split(derivative.verdict)
        axis.set_title(first, fontsize=8)
        for sentence in others:
            rest.setdefault(sentence, []).append(f"{response} by {variable}")
    whose = lambda names: "" if len(names) == len(entries) else f"{', '.join(names)}: "
    return sheet.done([whose(names) + sentence for sentence, names in rest.items()])


@answering
def sweep(study: Sweep, *, ax: Any = None) -> Any:
    """Every response over one swept variable or two.

    A second variable gives a line for each of its values, or colours over both where it has more
    than 8.

    Args:
        study: a `Sweep`, as `jaxclear.sweep` returns it.
        ax: `matplotlib.axes.Axes` to draw in, one for each response; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `study` is something else or has more than two variables.
    """
    expect(study, Sweep, "the study", "what jaxclear.sweep returns")
    if len(study.over) > 2:
        raise ValueError(
            f"the sweep is over {len(study.over)} variables; a figure shows two at the most: take "
            "a part of sweep.to_dataset()."
        )
    units = study.units()
    sides = [readable(v, units[name]) for name, v in study.over.items()]
    axes = zip(sides, study.over.values(), strict=True)
    along, *other = (factor * values for (factor, _), values in axes)
    names = [f"{name} [{unit}]" for name, (_, unit) in zip(study.over, sides, strict=True)]
    count = len(study.responses)
    sheet = panels("sweep", ax, 1, count, (4.8 * count, 3.8))
    for axis, (name, answers) in zip(sheet.axes.flat, study.responses.items(), strict=True):
        factor, unit = readable(answers[np.isfinite(answers)], units[name])
        axis.set_xlabel(names[0])
        if other and len(other[0]) > MOST_CURVES:
            drawn = axis.pcolormesh(along, other[0], factor * answers.T, shading="nearest")
            axis.set_ylabel(names[1])
            sheet.figure_of.colorbar(drawn, ax=axis, label=f"{name} [{unit}]")
            continue
        labels = [f"{x:.4g}" for x in other[0]] if other else [None]
        for label, line in zip(labels, factor * answers.reshape(len(along), -1).T, strict=True):
            axis.plot(along, line, "o-", ms=3, lw=1.0, label=label)
        axis.set_ylabel(f"{name} [{unit}]")
        if other:
            key(axis, title=textwrap.fill(names[1], IN_LEGEND))
    return sheet.done(as_warnings(study.warnings))


@answering
def work_precision(advice: Advice, *, ax: Any = None) -> Any:
    """Error of every setting of an integrator over its work, with the required accuracy.

    Each method is a line; the recommended setting has a ring. Hollow marks: other models of
    contact, with the error of the model. Triangles at the upper edge: settings that failed or have
    an error of 1 or more. Errors below a hundredth of the accuracy are drawn there.

    Args:
        advice: a `Advice`, as `jaxclear.advise` returns it.
        ax: `matplotlib.axes.Axes` to draw in; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `advice` is something else.
    """
    expect(advice, Advice, "the advice", "what jaxclear.advise returns")
    sheet = panels("work_precision", ax, size=(8.0, 5.4))
    axis, accuracy = sheet.one, advice.accuracy
    table = advice.table()
    table = table[table["work"] > 0]
    table = table.assign(error=table["error"].clip(LEAST_ERROR * accuracy))
    for name, rows in table.groupby("method", sort=False):
        style: dict[str, Any] = {"ms": 4}
        if rows["left out by the model"].notna().any():
            style = {"ms": 6, "mfc": "none"}
        if name == PRESENT:
            style = {"ms": 7, "marker": "x", "color": "0.35"}
        right = rows["error"] < LARGEST_ERROR
        how: dict[str, Any] = {"marker": "o", "lw": 1.2, "label": name} | style
        (line,) = axis.plot(rows["work"][right], rows["error"][right], **how)
        if not right.all():
            failed = rows["work"][~right]
            axis.plot(
                failed, LARGEST_ERROR + 0 * failed, "^", clip_on=False, c=line.get_color(), **EDGE
            )
    axis.plot([], [], "^", color="k", label=DIVERGED, **EDGE)
    best = table[table["recommended"]]
    ring: dict[str, Any] = {"ms": 14, "mfc": "none", "mec": "k", "mew": 1.6}
    axis.plot(best["work"], best["error"], "o", label="recommended", **ring)
    label = f"accuracy asked, {100 * accuracy:g} %"
    axis.axhline(accuracy, color="C3", ls="--", lw=1.0, label=label)
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_ylim(top=LARGEST_ERROR)
    axis.set_xlabel("evaluations of forces in a run [1]")
    axis.set_ylabel("largest estimated error of a response [1]")
    sheet.title(f"Recommended: {as_typed(advice.recommended)}")
    sheet.legend()
    return sheet.done(as_warnings(advice.warnings()))


WIDE = 4.4


def _label_rows(axis: Any, names: Sequence[str]) -> None:
    """A row for each name, the first on top."""
    axis.set_yticks(range(len(names)), names, fontsize=8)
    axis.set_ylim(len(names) - 0.5, -0.5)


def _interval(axis: Any, row: float, value: float, low: float, high: float, **how: Any) -> None:
    """A value with the interval in which it lies; one that is not bounded has none."""
    ends = np.nan_to_num([value - low, high - value], nan=0.0, posinf=0.0, neginf=0.0)
    axis.errorbar(value, row, xerr=ends.clip(0.0)[:, None], fmt="o", capsize=3, ms=4, **how)


@answering
def worst_case(study: WorstCase, *, ax: Any = None) -> Any:
    """Nominal value and extremes of each response, by runs and of first order.

    Args:
        study: a `WorstCase`, as `jaxclear.worst_case` returns it.
        ax: `matplotlib.axes.Axes` to draw in, one for each response; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `study` is something else.
    """
    expect(study, WorstCase, "the study", "what jaxclear.worst_case returns")
    names = list(study.nominal)
    sheet = panels("worst_case", ax, 1, len(names), (WIDE * len(names), 2.6))
    for axis, name in zip(sheet.axes.flat, names, strict=True):
        ends = [study.least[name], study.largest[name]]
        values = np.array([one.value for one in ends])
        factor, unit = readable(values, study.problem.units()[name])
        axis.plot(factor * values, [0, 0], "|-", color="C3", ms=16, lw=2, label="found by runs")
        first = [factor * one.first_order for one in ends]
        axis.plot(first, [1, 1], "|-", color="0.5", ms=16, lw=2, label="first order")
        axis.axvline(factor * study.nominal[name], color="k", lw=0.8, label="nominal")
        _label_rows(axis, ["found", "first order"])
        axis.set_xlabel(f"{name} [{unit}]")
    sheet.legend()
    sheet.title(f"Worst case, {study.runs} runs")
    return sheet.done()


def _samples_in_memory(study: MonteCarlo | Campaign) -> MonteCarlo:
    """The finished samples of a study, in memory."""
    what = "what jaxclear.monte_carlo or jaxclear.campaign returns"
    expect(study, (MonteCarlo, Campaign), "the study", what)
    return study.sample if isinstance(study, Campaign) else study


@answering
def error_budget(study: MonteCarlo | Campaign, *responses: str, ax: Any = None) -> Any:
    """Contribution of each variable to the variance of responses, with 95 % intervals.

    Contributions are percentages of the variance.

    Args:
        study: a `MonteCarlo` or `Campaign`, as `jaxclear.monte_carlo` or `jaxclear.campaign`
            returns it.
        responses: names of responses; all by default.
        ax: `matplotlib.axes.Axes` to draw in, one for each response; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `study` is something else or there is no such response.
    """
    study = _samples_in_memory(study)
    names = responses or tuple(study.responses)
    for name in names:
        check_name("response", name, study.responses, " in this study")
    rows = len(study.problem.variable_names) + 1
    size = (WIDE * len(names), 1.4 + 0.35 * rows)
    sheet = panels("error_budget", ax, 1, len(names), size, sharey=True)
    for axis, name in zip(sheet.axes.flat, names, strict=True):
        parts = study.error_budget(name)
        total = sum(part.value for part in parts.values()) or 1.0
        for row, part in enumerate(parts.values()):
            share, low, high = (100 * x / total for x in part)
            axis.barh(row, share, 0.6, color="C0", alpha=0.5)
            _interval(axis, row, share, low, high, color="k")
        _label_rows(axis, list(parts))
        axis.axvline(0.0, color="k", lw=0.6)
        axis.set_xlabel(f"share of the variance of {name} [%]")
    sheet.title("Error budget")
    return sheet.done()


def _by_variable(
    what: str, study: Any, kinds: dict, ax: Any, label: str, title: str, measured: bool = False
) -> Any:
    """A panel for each response with a row for each variable, and in it each of the `kinds` of
    numbers with its interval; `measured`: in units of the response."""
    first = next(iter(kinds.values()))
    names = list(dict.fromkeys(response for response, _ in first))
    variables = list(dict.fromkeys(variable for _, variable in first))
    size = (WIDE * len(names), 1.4 + 0.4 * len(variables))
    sheet = panels(what, ax, 1, len(names), size, sharey=True)
    places = (-0.15, 0.15) if len(kinds) > 1 else (0.0,)
    for axis, name in zip(sheet.axes.flat, names, strict=True):
        factor, unit = 1.0, "1"
        if measured:
            sizes = [
                each[name, variable].value for each in kinds.values() for variable in variables
            ]
            factor, unit = readable(sizes, study.problem.units()[name])
        for k, (kind, each) in enumerate(kinds.items()):
            for row, variable in enumerate(variables):
                named = kind if row == 0 else None
                numbers = [factor * number for number in each[name, variable]]
                _interval(axis, row + places[k], *numbers, color=f"C{k}", label=named)
        _label_rows(axis, variables)
        axis.axvline(0.0, color="0.7", lw=0.8)
        axis.set_xlabel(f"{label} {name} [{unit}]")
    if len(kinds) > 1:
        sheet.legend()
    sheet.title(f"{title}, {study.runs} runs")
    return sheet


@answering
def sobol_indices(study: SobolIndices, *, ax: Any = None) -> Any:
    """First-order and total Sobol' index of each variable, with 95 % intervals.

    Args:
        study: a `SobolIndices`, as `jaxclear.sobol_indices` returns it.
        ax: `matplotlib.axes.Axes` to draw in, one for each response; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `study` is something else.
    """
    expect(study, SobolIndices, "the study", "what jaxclear.sobol_indices returns")
    kinds = {"first order": study.first, "total": study.total}
    return _by_variable("sobol_indices", study, kinds, ax, "index of", "Sobol' indices").done()


@answering
def screening(study: Screening, *, ax: Any = None) -> Any:
    """Mean size and standard deviation of each variable's elementary effects, with 95 % intervals.

    Args:
        study: a `Screening`, as `jaxclear.screening` returns it.
        ax: `matplotlib.axes.Axes` to draw in, one for each response; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `study` is something else.
    """
    expect(study, Screening, "the study", "what jaxclear.screening returns")
    kinds = {"mu*": study.mu_star, "sigma": study.sigma}
    labels = "elementary effect on", "Screening", True
    return _by_variable("screening", study, kinds, ax, *labels).done(as_warnings(study.warnings))


@answering
def shapley_effects(study: ShapleyEffects, *, ax: Any = None) -> Any:
    """Shapley effect of each variable, with 95 % intervals.

    Args:
        study: a `ShapleyEffects`, as `jaxclear.shapley_effects` returns it.
        ax: `matplotlib.axes.Axes` to draw in, one for each response; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `study` is something else.
    """
    expect(study, ShapleyEffects, "the study", "what jaxclear.shapley_effects returns")
    labels = "Shapley effect on", "Shapley effects"
    sheet = _by_variable("shapley_effects", study, {"effect": study.effects}, ax, *labels)
    return sheet.done([study.remark] if study.remark else [])


@answering
def surface(result: ResponseSurface, *, ax: Any = None) -> Any:
    """Predictions of a response surface over runs that it was fitted without (leave-one-out).

    Args:
        result: a `ResponseSurface`, as `jaxclear.surface` returns it.
        ax: `matplotlib.axes.Axes` to draw in, one for each response; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `result` is something else.
    """
    expect(result, ResponseSurface, "the surface", "what jaxclear.surface returns")
    names = list(result.problem.response_names)
    sheet = panels("surface", ax, 1, len(names), (WIDE * len(names), 4.0))
    for axis, name in zip(sheet.axes.flat, names, strict=True):
        answers, predicted = result.responses[name], result.predictions[name]
        factor, unit = readable(answers, result.problem.units()[name])
        ends = factor * np.array([answers.min(), answers.max()])
        axis.plot(ends, ends, color="0.6", lw=1.0, zorder=0)
        axis.plot(factor * answers, factor * predicted, "o", ms=3, alpha=0.6)
        axis.set_xlabel(f"{name} by runs [{unit}]")
        axis.set_ylabel(f"by the surface without the run [{unit}]")
        quality = f"degree {result.degrees[name]}, leave-one-out R² {result.quality[name]:.4f}"
        trusted = result.trusted(name)
        text = quality if trusted else f"{quality}: does not stand for runs"
        axis.set_title(text, fontsize=8, color="k" if trusted else "C3")
    return sheet.done()


def _draw_means(what: str, means: dict, deviations: dict, problem: Any, ax: Any, title: str) -> Any:
    """Mean and mean ± standard deviation of responses, each with its 95 % error."""
    sheet = panels(what, ax, 1, len(means), (WIDE * len(means), 2.4))
    for axis, (name, value_of) in zip(sheet.axes.flat, means.items(), strict=True):
        factor, unit = readable([value_of.value], problem.units()[name])
        mean, error = factor * value_of.value, factor * value_of.error
        spread, off = factor * deviations[name].value, factor * deviations[name].error
        axis.barh(1, 2 * spread, 0.5, left=mean - spread, color="C1", alpha=0.4)
        _interval(axis, 0, mean, mean - error, mean + error, color="k")
        for side in (-1, 1):
            end = mean + side * spread
            _interval(axis, 1, end, end - off, end + off, color="C1")
        _label_rows(axis, ["mean", "mean ± deviation"])
        axis.set_xlabel(f"{name} [{unit}]")
    sheet.title(title)
    return sheet.done()


@answering
def corrected_statistics(study: CorrectedStatistics, *, ax: Any = None) -> Any:
    """Mean and standard deviation of each response by a corrected surface, with 95 % errors.

    Args:
        study: a `CorrectedStatistics`, as `jaxclear.corrected_statistics` returns it.
        ax: `matplotlib.axes.Axes` to draw in, one for each response; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `study` is something else.
    """
    expect(study, CorrectedStatistics, "the study", "what jaxclear.corrected_statistics returns")
    title = f"Surface corrected by {study.runs} runs"
    problem = study.surface.problem
    return _draw_means("corrected_statistics", study.means, study.deviations, problem, ax, title)


@answering
def multi_fidelity(study: MultiFidelity, *, ax: Any = None) -> Any:
    """Mean and standard deviation of each response by models of several costs, with 95 % errors.

    Args:
        study: a `MultiFidelity`, as `jaxclear.multi_fidelity` returns it.
        ax: `matplotlib.axes.Axes` to draw in, one for each response; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `study` is something else.
    """
    expect(study, MultiFidelity, "the study", "what jaxclear.multi_fidelity returns")
    spread = study.standard_deviations
    title = f"{study.runs[0]} runs of the problem and {sum(study.runs[1:])} of cheaper ones"
    return _draw_means("multi_fidelity", study.means, spread, study.problem, ax, title)


@answering
def reliability(study: Reliability, *, ax: Any = None) -> Any:
    """Probability of failure by each method, with 95 % intervals, and importance of the variables.

    The method of the answer is drawn in black.

    Args:
        study: a `Reliability`, as `jaxclear.reliability` returns it.
        ax: two `matplotlib.axes.Axes` to draw in; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `study` is something else.
    """
    expect(study, Reliability, "the study", "what jaxclear.reliability returns")
    finite = {name: e for name, e in study.estimates.items() if np.isfinite(e.value)}
    shares = study.importance()
    tall = 1.6 + 0.34 * max(len(finite), len(shares), 2)
    sheet = panels("reliability", ax, 1, 2, (10.0, tall))
    methods_axis, right = sheet.axes.flat
    for row, (name, e) in enumerate(finite.items()):
        colour = "k" if name == study.method else "C0"
        _interval(methods_axis, row, e.value, *e.interval, color=colour)
    _label_rows(methods_axis, list(finite))
    if any(e.value > 0 for e in finite.values()):
        methods_axis.set_xscale("log")
    methods_axis.set_xlabel("probability of failing [1]")
    right.barh(range(len(shares)), [100 * x for x in shares.values()], 0.6, color="C0")
    _label_rows(right, list(shares))
    right.set_xlabel("importance at the likeliest design point [%]")
    sheet.title(f"P({study.limit.words()}), {study.runs} runs")
    return sheet.done(study.notes)
