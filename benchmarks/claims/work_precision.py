"""Error against cost of every rung, as `jaxclear.advise` measures it: slider-crank and four-bar, a
table and a picture of each.

Errors are those of means over a few nearly equal runs, against a tight adaptive reference. Rungs of
another formulation (rigid contact, joints that always touch) come no nearer than their model: where
their points stop falling is what the model is off. Pictures go to `figures` beside this file (or
`--figures`).
"""

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import jaxclear as jc
from benchmarks.measure import report
from jaxclear import plot
from jaxclear.scenes import four_bar

STEPS = (1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5, 5e-6, 2e-6)
COPIES = 8


def candidates(shortest: float, touching: bool) -> dict[str, list]:
    """Every kind of integrator, coarse to fine; `touching`: also the one whose joints always
    touch."""
    kinds = jc.integrator
    steps = [step for step in STEPS if step >= shortest]
    rungs = {
        "Adaptive": [kinds.Adaptive(rtol=10.0**-n, atol=10.0 ** -(n + 2)) for n in range(3, 10)],
        "FixedStep rk4": [kinds.FixedStep(step) for step in steps],
        "FixedStep semi-implicit": [kinds.FixedStep(step, "semi_implicit") for step in steps],
        "FixedStep, 16 in contact": [kinds.FixedStep(step, contact_steps=16.0) for step in steps],
        "ImplicitStep": [kinds.ImplicitStep(step) for step in steps],
        "MoreauJean": [kinds.MoreauJean(step) for step in steps],
    }
    if touching:
        rungs["NonColliding"] = [kinds.NonColliding(step) for step in steps]
    return rungs


def slider_crank() -> jc.Mechanism:
    """The scene with 0.1 mm of clearance, the law to start from and smooth friction."""
    steel = jc.Material(young_modulus=207e9, poisson_ratio=0.3)
    return jc.scenes.slider_crank(
        clearance=0.1e-3,
        contact=jc.contact.CarvalhoMartins(
            jc.stiffness.HertzStiffness(steel, steel), restitution=0.9
        ),
        friction=jc.friction.CoulombTanh(mu_kinetic=0.05),
    )


def questions(quick: bool) -> dict[str, tuple[jc.Problem, bool]]:
    """What is asked of each mechanism, and whether its joints may be taken as always touching."""
    duration = 0.05 if quick else 0.25
    clearance = jc.Variable(lambda rig: rig.connections["B"].joint.clearance, tolerance=1e-6)
    force = {"mean force": jc.response.MeanContactForce("B")}
    place = {"slider's end": jc.response.FinalCoordinate("G", unit="m")}
    crank = jc.Problem(
        slider_crank(), force | place, {"clearance": clearance}, duration=duration, save=501
    )
    duration = 0.2 if quick else 0.628
    worn = {"worn volume": jc.response.WornVolume("B")}
    bars = jc.Problem(
        four_bar("spatial"), force | worn, {"clearance": clearance}, duration=duration, save=251
    )
    return {"slider-crank": (crank, True), "four-bar": (bars, False)}


def rows_of(advice) -> list[dict]:
    table = advice.table().reset_index()
    return [dict(row) for row in table.to_dict("records")]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="short runs, long steps only")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures here")
    parser.add_argument(
        "--figures", type=Path, default=Path(__file__).parent / "figures", metavar="DIR"
    )
    options = parser.parse_args()
    options.figures.mkdir(parents=True, exist_ok=True)
    for name, (problem, touching) in questions(options.quick).items():
        tried = candidates(5e-5 if options.quick else 2e-6, touching)
        advice = jc.advise(
            problem,
            0.01,
            candidates=tried,
            pilot=jc.PilotSettings(copies=COPIES, duration=float(problem.duration)),
            means=True,
        )
        print(advice.sentence())
        report(f"{name}: error and cost, method by method", rows_of(advice), options)
        figure = plot.work_precision(advice)
        figure.savefig(options.figures / f"work_precision_{name.replace('-', '_')}.png", dpi=110)


if __name__ == "__main__":
    main()
