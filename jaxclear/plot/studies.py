"""Figures of studies: spread of responses, derivatives with errors, work against precision."""

import re
import textwrap
from typing import Any

import numpy as np

from jaxclear.ground.arguments import expect
from jaxclear.ground.in_words import as_typed
from jaxclear.plot.canvas import panels, readable
from jaxclear.plot.fitting import Roomy, key
from jaxclear.studies.advice import PRESENT, Advice
from jaxclear.studies.monte_carlo import MonteCarlo
from jaxclear.studies.sensitivity.derivative import Sensitivity
from jaxclear.studies.sweep import Sweep

__all__ = ["monte_carlo", "sensitivity", "sweep", "work_precision"]

# An error as large as the response is drawn no higher, a hundredth of the accuracy no lower.
LARGEST_ERROR, LEAST_ERROR = 1.0, 0.01
DIVERGED = "failed, or no digit right"
EDGE: dict[str, Any] = {"mfc": "none", "ms": 7, "zorder": 4}
# Panels side by side; values of a second variable up to which each has a line; letters in a line of
# a legend.
MOST_BESIDE, MOST_CURVES, IN_LEGEND = 3, 8, 24
# Where a sentence ends.
SENTENCES = re.compile(r"(?<=[.!?]) +(?=[A-Z0-9])")


def monte_carlo(study: MonteCarlo, *, ax: Any = None) -> Any:
    """Histogram of every response over the sample, with mean and 5 to 95 % range.
    `ax`: one axes for each response."""
    expect(study, MonteCarlo, "the study", "what jaxclear.monte_carlo returns")
    names = list(study.responses)
    sheet = panels("monte_carlo", ax, 1, len(names), (4.6 * len(names), 3.8))
    for axis, name in zip(sheet.axes.flat, names, strict=True):
        told = study.good(name)[0]
        values = told[np.isfinite(told)]
        factor, unit = readable(values, study.problem.units()[name])
        axis.hist(factor * values, bins="auto", color="C0", alpha=0.8)
        axis.set_xlabel(f"{name} [{unit}]")
        if len(values) < len(told):
            # Of infinite answers, as lives may be, there is no mean, and no place on an axis.
            axis.set_xlabel(f"{name} [{unit}], infinite in {len(told) - len(values)} more")
        else:
            axis.axvline(factor * values.mean(), color="k", lw=1.2, label="mean")
            low, high = np.percentile(factor * values, [5, 95])
            axis.axvspan(low, high, color="C1", alpha=0.25, label="5 to 95 %", zorder=0)
        axis.set_ylabel("samples")
        axis.yaxis.set_major_locator(Roomy(whole=True))
    sheet.legend()
    sheet.title(f"Monte Carlo, {study.count} samples, {len(study.failed)} failed")
    return sheet.done(_warned_samples(study))


def _warned_samples(study: MonteCarlo) -> list[str]:
    """How many samples warn, and what the means are without them."""
    if not len(study.warned) and not study.doubts:
        return []
    told = [*study.doubts] or [study.sentence()]
    for row in study.summary().to_dict("records"):
        if row["warned"]:
            values = study.responses[row["response"]]
            factor, unit = readable(values[np.isfinite(values)], row["unit"])
            means = (
                f"the mean is {factor * row['mean']:.4g} with them, "
                f"{factor * row['mean without warned']:.4g} without [{unit}]."
            )
            if row.get("infinite"):
                means = f"there is no mean, infinite in {row['infinite']} samples."
            told += [f"{row['response']}: {row['warned']} in doubt; {means}"]
    return told


def sensitivity(study: Sensitivity, *, ax: Any = None) -> Any:
    """Every derivative by every method, with its 95 % interval; a method that refused is named, not
    drawn. `ax`: one axes for each derivative.
    """
    expect(study, Sensitivity, "the study", "what jaxclear.sensitivity returns")
    entries = list(study.derivatives.items())
    alike = len({tuple(found.estimates) for _, found in entries}) == 1
    columns = len(entries) if ax is not None else min(len(entries), MOST_BESIDE)
    rows = -(-len(entries) // columns)
    size = 4.6 * columns, 3.6 * rows
    sheet = panels("sensitivity", ax, rows, columns, size, sharey=alike)
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


def sweep(study: Sweep, *, ax: Any = None) -> Any:
    """Every response over the first swept variable, with a line for each value of a second one, or
    over both as colours where these are many. `ax`: one axes for each response. Raises `ValueError`
    for more than two variables."""
    expect(study, Sweep, "the study", "what jaxclear.sweep returns")
    if len(study.over) > 2:
        raise ValueError(
            f"the sweep is over {len(study.over)} variables; a figure shows two at the most: take "
            "a part of sweep.to_dataset()."
        )
    units = study.units()
    sides = [readable(own, units[name]) for name, own in study.over.items()]
    axes = zip(sides, study.over.values(), strict=True)
    along, *other = (factor * values for (factor, _), values in axes)
    names = [f"{name} [{unit}]" for name, (_, unit) in zip(study.over, sides, strict=True)]
    count = len(study.responses)
    sheet = panels("sweep", ax, 1, count, (4.8 * count, 3.8))
    for axis, (name, told) in zip(sheet.axes.flat, study.responses.items(), strict=True):
        factor, unit = readable(told[np.isfinite(told)], units[name])
        axis.set_xlabel(names[0])
        if other and len(other[0]) > MOST_CURVES:
            drawn = axis.pcolormesh(along, other[0], factor * told.T, shading="nearest")
            axis.set_ylabel(names[1])
            sheet.whole.colorbar(drawn, ax=axis, label=f"{name} [{unit}]")
            continue
        labels = [f"{x:.4g}" for x in other[0]] if other else [None]
        for label, line in zip(labels, factor * told.reshape(len(along), -1).T, strict=True):
            axis.plot(along, line, "o-", ms=3, lw=1.0, label=label)
        axis.set_ylabel(f"{name} [{unit}]")
        if other:
            key(axis, title=textwrap.fill(names[1], IN_LEGEND))
    return sheet.done([*study.warnings])


def work_precision(advice: Advice, *, ax: Any = None) -> Any:
    """Error of every setting against its work, one line a method, with the accuracy asked and the
    recommended setting.

    Hollow marks: other models of contact, off by what they leave out. Triangles at the upper edge:
    settings that err by LARGEST_ERROR or more, or failed; errors of less than LEAST_ERROR of the
    accuracy are drawn there. `ax`: axes to draw in.
    """
    expect(advice, Advice, "the advice", "what jaxclear.advise returns")
    sheet = panels("work_precision", ax, size=(8.0, 5.4))
    axis, asked = sheet.one, advice.accuracy
    table = advice.table()
    table = table[table["work"] > 0]
    table = table.assign(error=table["error"].clip(LEAST_ERROR * asked))
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
            lost = rows["work"][~right]
            axis.plot(
                lost, LARGEST_ERROR + 0 * lost, "^", clip_on=False, c=line.get_color(), **EDGE
            )
    axis.plot([], [], "^", color="k", label=DIVERGED, **EDGE)
    best = table[table["recommended"]]
    ring: dict[str, Any] = {"ms": 14, "mfc": "none", "mec": "k", "mew": 1.6}
    axis.plot(best["work"], best["error"], "o", label="recommended", **ring)
    told = f"accuracy asked, {100 * asked:g} %"
    axis.axhline(asked, color="C3", ls="--", lw=1.0, label=told)
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_ylim(top=LARGEST_ERROR)
    axis.set_xlabel("evaluations of forces in a run [1]")
    over = ", means over the copies" if advice.wanted.means else ""
    axis.set_ylabel(f"largest estimated error of a response [1]{over}")
    sheet.title(f"Recommended: {as_typed(advice.recommended)}")
    sheet.legend()
    return sheet.done(advice.warnings())
