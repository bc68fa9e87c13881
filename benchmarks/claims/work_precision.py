"""Error against cost of every rung, for every scene and all that is asked of it: the book's tables
and pictures of speed traded for accuracy.

    python -m benchmarks.claims.work_precision [--quick] [--scene NAME ...] [--json FILE]
        [--figures DIR]

Errors are judged by `Adaptive` at two tight tolerances (`benchmarks.trade.curves`). Rungs of
another formulation (rigid contact, joints that always touch) come no nearer than their model: where
their points stop falling is what the model is off. With `--json` the scenes that are measured
replace their rows in the file, which tells of each scene when it was measured; the summary is made
anew from all of it, and the pictures are drawn from the file.
"""

import argparse
import fcntl
import json
import math
import statistics
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
from benchmarks.measure import about, date, report
from benchmarks.trade.curves import Curves, curves
from benchmarks.trade.questions import SCENES
from jaxclear.plot.canvas import canvas, captioned

FIGURES = Path(__file__).resolve().parents[2] / "notebooks" / "_figures"
QUICK = ("slider-crank, ideal",)
# What is asked; and an error from which on no digit is right: axes end there.
ACCURACY, LARGEST = 0.01, 1.0
ALONE, BATCH = "alone [ms/s]", "in a batch [ms/s]"
# Titles of the tables: of every setting of a scene, and of the summaries.
POINTS = "{scene}: every setting"
SUMMARY = {
    ALONE: "CPU time alone [ms for a simulated second] to 1 %",
    BATCH: "CPU time of a sample in a batch [ms for a simulated second] to 1 %",
}
# Titles of who reaches the accuracy: of scenes with clearance, and of those without.
STANDING = {
    "clearance": "Joints with clearance, answers to 1 %",
    "ideal": "Ideal joints, answers to 1 %",
}
# Scenes are measured in several calls.
COMMAND = {"command": "python -m benchmarks.claims.work_precision --scene NAME ..."}
WHEN = "when each scene was measured"
DOUBT = "references apart"
ERROR = "error in "
Rows = list[dict[str, Any]]


def rows_of(found: Curves) -> Rows:
    """A row for every setting; the first one tells how far the references are apart."""
    doubt = {f"{ERROR}{name}": value for name, value in found.doubts.items()}
    first = {"rung": "reference", "setting": DOUBT, ALONE: 1e3 * found.reference, BATCH: None}
    rows = [first | doubt | {"said": ""}]
    for point in found.points:
        row = {"rung": point.rung, "setting": point.setting, ALONE: _milli(point.alone)}
        row |= {BATCH: _milli(point.in_batch)}
        row |= {f"{ERROR}{name}": point.errors.get(name) for name in found.doubts}
        rows.append(row | {"said": point.said})
    return rows


def _milli(seconds: float) -> float | None:
    return 1e3 * seconds if math.isfinite(seconds) else None


def scenes_in(document: dict[str, Rows]) -> Iterator[tuple[str, Rows]]:
    """Scenes of a document in their order, with their rows."""
    for scene in SCENES:
        title = POINTS.format(scene=scene)
        if title in document:
            yield scene, document[title]


def responses_of(rows: Rows) -> list[str]:
    """Names of the responses of a scene."""
    return [name.removeprefix(ERROR) for name in rows[0] if name.startswith(ERROR)]


def cheapest(rows: Rows, rung: str, response: str, cost: str) -> str:
    """Cost of the coarsest setting of a rung that is within the accuracy and whose finer one is
    too; in brackets the smallest error [%] where there is none."""
    own = [row for row in rows if row["rung"] == rung]
    errors = [row[ERROR + response] for row in own]
    good = [error is not None and error <= ACCURACY for error in errors]
    for place, row in enumerate(own):
        if all(good[place : place + 2]):
            return "not measured" if row[cost] is None else f"{row[cost]:.3g}"
    known = [error for error in errors if error is not None and math.isfinite(error)]
    return f"({100 * min(known):.2g} %)" if known else "fails"


def summary(document: dict[str, Rows], cost: str) -> Rows:
    """A row for every scene and response, a column for every rung."""
    parts = list(scenes_in(document))
    rungs = list(dict.fromkeys(row["rung"] for _, rows in parts for row in rows[1:]))
    table = []
    for scene, rows in parts:
        own = {row["rung"] for row in rows}
        for name in responses_of(rows):
            row = {"scene": scene, "response": name}
            row[f"{DOUBT} [%]"] = f"{100 * rows[0][ERROR + name]:.1g}"
            cells = {r: cheapest(rows, r, name, cost) if r in own else None for r in rungs}
            table.append(row | cells)
    return table


def standings(document: dict[str, Any], joints: str) -> Rows:
    """A row for every integrator: in how many answers it reaches the accuracy, in how many at the
    least cost, and what it takes beside the least; alone and in a batch."""
    table: dict[str, dict[str, Any]] = {}
    for how, title in zip(("alone", "in a batch"), SUMMARY.values(), strict=True):
        answers = [list(row.items()) for row in document[title] if joints == _joints(row["scene"])]
        costs = [{name: float(c) for name, c in row[3:] if _is_cost(c)} for row in answers]
        for name, _ in answers[0][3:]:
            asked = sum(dict(row).get(name) is not None for row in answers)
            ratios = [own[name] / min(own.values()) for own in costs if name in own]
            if ratios:
                row = table.setdefault(name, {"integrator": name, "answers": asked})
                row[f"within 1 %, {how}"] = len(ratios)
                row[f"cheapest, {how}"] = ratios.count(1)
                row[f"cost / least, {how}: median"] = statistics.median(ratios)
                row[f"largest, {how}"] = max(ratios)
    return list(table.values())


def _joints(scene: str) -> str:
    return "ideal" if "ideal" in scene else "clearance"


def _is_cost(cell: str | None) -> bool:
    """Whether a cell of the summary is a cost: not an error in brackets, nor a failure."""
    return cell is not None and cell[0].isdigit()


def draw(scene: str, rows: Rows, folder: Path) -> Path:
    """A picture of a scene: a panel for every response, a line for every rung; filled: alone,
    hollow: a sample in a batch; triangles at the upper edge: no digit is right, or it diverged."""
    names = responses_of(rows)
    across = min(3, len(names))
    down = -(-len(names) // across)
    figure, axes = canvas(down, across, (4.0 * across, 3.1 * down), squeeze=False)
    rungs = list(dict.fromkeys(row["rung"] for row in rows[1:]))
    for axis, name in zip(axes.flat, names, strict=False):
        axis.set(xscale="log", yscale="log")
        for number, rung in enumerate(rungs):
            own = [row for row in rows if row["rung"] == rung and row[ERROR + name] is not None]
            for cost, style in ((ALONE, "o-"), (BATCH, "o:")):
                known = [(row[cost], row[ERROR + name]) for row in own if row[cost]]
                points = [(work, error) for work, error in known if 0 < error < LARGEST]
                lost = [(work, LARGEST) for work, error in known if not error < LARGEST]
                how = {"color": f"C{number}", "mfc": f"C{number}" if cost == ALONE else "none"}
                label = rung if cost == ALONE else None
                if points:
                    axis.plot(*zip(*points, strict=True), style, ms=4, lw=1, label=label, **how)
                if lost:
                    axis.plot(*zip(*lost, strict=True), "^", ms=6, clip_on=False, **how)
        if not axis.has_data():
            axis.set(ylim=(0.01 * ACCURACY, LARGEST), xlim=(1.0, 1e3))
            axis.text(0.5, 0.7, "no setting errs", ha="center", transform=axis.transAxes)
        axis.axhline(ACCURACY, color="k", lw=0.6)
        axis.set(title=name, xlabel="CPU time [ms for a simulated s]", ylabel="error [1]")
        axis.set_ylim(top=LARGEST)
        axis.grid(alpha=0.3)
    for axis in axes.flat[len(names) :]:
        axis.remove()
    figure.legend(*axes.flat[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    captioned(figure)
    path = folder / f"work_precision_{slug(scene)}.png"
    figure.savefig(path, dpi=80)
    return path


def slug(scene: str) -> str:
    """A scene's name in that of a file."""
    return scene.replace(", ", "_").replace("-", "_")


def written(scene: str, rows: Rows, path: Path | None) -> dict[str, Any]:
    """The document with a scene's new rows, written where there is a path. Other processes may
    measure other scenes meanwhile: the file is read and written by one at a time."""
    if path is None:
        return _with(scene, rows, {})
    path.touch()
    with path.open("r+") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        document = _with(scene, rows, json.loads(file.read() or "{}"))
        file.seek(0)
        file.truncate()
        file.write(json.dumps(document, indent=1) + "\n")
    return document


def _with(scene: str, rows: Rows, known: dict[str, Any]) -> dict[str, Any]:
    before = known.get("about", {}).get("date", "")
    dates = {row["scene"]: row["measured"] for row in known.get(WHEN, [])} | {scene: date()}
    measured = dict(scenes_in(known | {POINTS.format(scene=scene): rows}))
    points = {POINTS.format(scene=name): own for name, own in measured.items()}
    machine = known.get("about", {}).get("machine")
    told = about("benchmarks.claims.work_precision", None) | COMMAND
    told |= {} if machine is None else {"machine": machine}
    summaries = {title: summary(points, cost) for cost, title in SUMMARY.items()}
    some = dict.fromkeys(map(_joints, measured))
    return (
        {"about": told}
        | {STANDING[joints]: standings(summaries, joints) for joints in some}
        | summaries
        | {WHEN: [{"scene": name, "measured": dates.get(name, before)} for name in measured]}
        | points
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one scene without clearance")
    parser.add_argument("--scene", nargs="*", choices=SCENES, help="these scenes alone")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures here")
    parser.add_argument("--figures", type=Path, default=FIGURES, metavar="DIR")
    options = parser.parse_args()
    document: dict[str, Any] = {}
    for scene in options.scene or (QUICK if options.quick else SCENES):
        begun = time.process_time()
        rows = rows_of(curves(SCENES[scene]()))
        print(f"{scene}: {time.process_time() - begun:.0f} s CPU", flush=True)
        jax.clear_caches()
        document = written(scene, rows, options.json)
        if options.json:
            draw(scene, rows, options.figures)
    for cost, title in SUMMARY.items():
        report(title, summary(document, cost), argparse.Namespace(json=None))


if __name__ == "__main__":
    main()
