"""How far an ideal loop opens over time: the ideal four-bar with Baumgarte's stabilisation at
several gains, and with none.

A closed loop is held by accelerations, so what steps lose adds up: without stabilisation the
residual grows about as t^2, with it the residual settles where the loss of a step balances its
decay, as long as gain x step stays well below 2.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

import jaxclear as jc
from benchmarks.measure import report, sign

DURATION, QUICK_DURATION, SAVES = 20.0, 2.0, 401
GAINS = (None, 1.0, 10.0, 50.0, 200.0, 1000.0, "projection")
INTEGRATORS = {
    "FixedStep rk4, 1e-3 s": jc.integrator.FixedStep(1e-3, "rk4"),
    "FixedStep rk4, 1e-4 s": jc.integrator.FixedStep(1e-4, "rk4"),
    "ImplicitStep, 1e-3 s": jc.integrator.ImplicitStep(1e-3),
    "Adaptive, rtol 1e-4": jc.integrator.Adaptive(rtol=1e-4, atol=1e-6),
    "Adaptive, rtol 1e-7": jc.integrator.Adaptive(),
}
QUICK = ("FixedStep rk4, 1e-3 s", "Adaptive, rtol 1e-7")


def options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--quick", action="store_true", help="two integrators and a tenth of the time"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures here")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="draw drift over time as a PNG")
    return parser.parse_args()


def four_bar(gain: float | str | None) -> jc.Mechanism:
    """The loop with alpha = beta = `gain` [1/s]; None: no stabilisation; "projection": closed anew
    after every step.
    """
    stabilisation = (
        None
        if gain is None
        else jc.Projection()
        if gain == "projection"
        else jc.Baumgarte(gain, gain)
    )
    whole = jc.scenes.four_bar("ideal")
    return jc.Mechanism(
        whole.bodies,
        whole.connections,
        whole.loads,
        guess={"A": 0.81, "D": 1.32},
        stabilisation=stabilisation,
    )


def drift(
    gain: float | str | None, integrator: Any, duration: float
) -> tuple[dict[str, Any], Any, np.ndarray]:
    """(row of the table, times, largest residual of the loop at each)."""
    rig = four_bar(gain)
    begun = time.process_time()
    run = jc.simulate(rig, duration, save=SAVES, integrator=integrator, throw=False)
    first = time.process_time() - begun
    size = np.max([np.asarray(part) for part in run.drift().values()], axis=0)
    row = {
        "after a tenth [m]": float(size[SAVES // 10]),
        "at the end [m]": float(size[-1]),
        "largest [m]": float(size.max()),
    }
    steps = {
        "steps": int(run.accepted_steps) + int(run.rejected_steps),
        "CPU with compilation [s]": first,
    }
    return row | steps | {"result": "ok" if run.succeeded else run.result}, run.time, size


def draw(curves: list[tuple[str, str, Any, np.ndarray]], file: Path) -> None:
    """One panel for each integrator, one line for each gain."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    names = list(dict.fromkeys(name for name, *_ in curves))
    figure, panels = pyplot.subplots(
        1, len(names), figsize=(4 * len(names), 4), sharey=True, squeeze=False, layout="constrained"
    )
    for panel, name in zip(panels[0], names, strict=True):
        for gain, t, size in [rest for own, *rest in curves if own == name]:
            panel.semilogy(t, np.maximum(size, 1e-17), label=gain, linewidth=1)
        panel.set(title=name, xlabel="time [s]")
    panels[0][0].set_ylabel("residual of the loop [m]")
    handles, labels = panels[0][0].get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        title="Baumgarte's alpha = beta [1/s], or",
        loc="outside lower center",
        ncols=len(labels),
    )
    figure.savefig(file, dpi=80)


def main() -> None:
    asked = options()
    duration = QUICK_DURATION if asked.quick else DURATION
    rows, curves = [], []
    for name in QUICK if asked.quick else INTEGRATORS:
        for gain in GAINS:
            if gain == "projection" and isinstance(INTEGRATORS[name], jc.integrator.Adaptive):
                continue
            label = "none" if gain is None else gain if gain == "projection" else f"{gain:g}"
            row, t, size = drift(gain, INTEGRATORS[name], duration)
            rows.append({"integrator": name, "alpha = beta [1/s]": label} | row)
            curves.append((name, label, t, size))
    report(f"drift of the ideal four-bar's loop in {duration:g} s", rows, asked)
    sign("benchmarks.claims.drift", asked.json)
    if asked.figure is not None:
        draw(curves, asked.figure)


if __name__ == "__main__":
    main()
