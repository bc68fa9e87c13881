"""Bad arguments of every public function and of the methods of runs, problems and mechanisms, by
the kinds of `generated`."""

import functools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import jaxclear as jc
from jaxclear import plot
from tests.bad_input.generated import BODY, KINDS, STEEL, Case


@functools.cache
def rig() -> jc.Mechanism:
    return jc.scenes.slider_crank()


@functools.cache
def run() -> jc.Trajectory:
    return jc.simulate(rig(), 1e-3, save=3)


@functools.cache
def problem(**changes: Any) -> jc.Problem:
    return jc.Problem(
        rig(),
        {"force": jc.response.MeanContactForce("B")},
        {"clearance": jc.Variable(clearance, tolerance=1e-5)},
        duration=2e-4,
        save=2,
        integrator=jc.integrator.FixedStep(2e-5),
    )


def clearance(rig: jc.Mechanism) -> Any:
    return rig.connections["B"].joint.clearance


def draft(**changes: Any) -> jc.Problem:
    """A problem with something changed."""
    given = {
        "mechanism": rig(),
        "response": jc.response.MeanContactForce("B"),
        "variables": {"clearance": jc.Variable(clearance, tolerance=1e-5)},
        "duration": 2e-4,
        "save": 2,
    }
    return jc.Problem(**(given | changes))


@functools.cache
def sample() -> Any:
    return jc.monte_carlo(problem(), 4)


Shape = jc.stiffness.Shape(1.0, 2.0)
SAVE = {"text": "all", "none": None, "one": 1, "part": 2.5, "flag": True, "nan": float("nan")}
SAVE |= {"backwards": [0.0, 2e-4, 1e-4], "beyond": [0.0, 9.0], "empty": [], "words": ["a", "b"]}
SAVE |= {"body": BODY, "two axes": np.zeros((2, 2)), "negative": -3}
PARTS = {"text": "x", "number": 3.0, "none": None, "list": [], "class": jc.Body, "body": BODY}
MAPPING = {"text": "x", "number": 3.0, "list": [1], "body": BODY, "keys": {3: BODY}}
NOT_NONE = {k: v for k, v in PARTS.items() if k != "none"}
NO_TEXT = {k: v for k, v in PARTS.items() if k != "text"}
ONES = np.ones(3)
POSITIVE = KINDS["positive"]
# For every function: what is called with the one argument, the argument's name, its wrong values.
TABLE: list[tuple[str, str, Callable[[Any], Any], dict[str, Any]]] = [
    ("simulate", "mechanism", lambda x: jc.simulate(x, 1e-3), PARTS),
    ("simulate", "duration", lambda x: jc.simulate(rig(), x), POSITIVE | {"none": None}),
    ("simulate", "save", lambda x: jc.simulate(rig(), 2e-4, save=x), SAVE),
    ("simulate", "integrator", lambda x: jc.simulate(rig(), 1e-3, integrator=x), NOT_NONE),
    ("simulate", "concentric", lambda x: short(state=jc.State(concentric=x)), KINDS["flag"]),
    ("simulate", "balance", lambda x: short(balance=x), KINDS["flag"]),
    ("simulate", "progress_bar", lambda x: short(progress_bar=x), KINDS["flag"]),
    ("simulate", "throw", lambda x: short(throw=x), KINDS["flag"]),
    ("assemble", "assembled", lambda x: jc.assemble(x), PARTS),
    ("assemble", "concentric", lambda x: jc.assemble(rig(), x), KINDS["flag"]),
    ("Mechanism", "bodies", lambda x: jc.Mechanism(x, {}), MAPPING | {"none": None, "empty": {}}),
    ("Mechanism", "connections", lambda x: jc.Mechanism({"a": BODY}, x), MAPPING | {"none": None}),
    ("Mechanism", "loads", lambda x: changed(loads=x), MAPPING),
    ("Mechanism", "start", lambda x: changed(start=x), MAPPING | {"value": {"G": "x"}}),
    ("Mechanism", "speeds", lambda x: changed(speeds=x), MAPPING | {"value": {"G": [[1]]}}),
    ("Mechanism", "stabilisation", lambda x: changed(stabilisation=x), NOT_NONE),
    ("Marker", "body", lambda x: jc.Marker(x), KINDS["name"]),
    ("Marker", "at", lambda x: jc.Marker("arm", x), KINDS["vector"]),
    ("Marker", "axis", lambda x: jc.Marker("arm", axis=x), KINDS["vector"] | {"none of xyz": "w"}),
    ("Marker", "quaternion", lambda x: jc.Marker("arm", quaternion=x), KINDS["vector"]),
    ("Connection", "joint", lambda x: jc.Connection(x, "a", "b"), PARTS),
    ("Connection", "parent", lambda x: jc.Connection(REVOLUTE, x, "b"), NO_TEXT),
    ("Connection", "child", lambda x: jc.Connection(REVOLUTE, "a", x), NO_TEXT),
    ("Connection", "at", lambda x: jc.Connection(REVOLUTE, "a", "b", at=x), KINDS["vector"]),
    ("Connection", "axis", lambda x: jc.Connection(REVOLUTE, "a", "b", axis=x), KINDS["vector"]),
    ("ContactForce", "elastic", lambda x: jc.contact.ContactForce(x), PARTS),
    ("ContactForce", "dissipation", lambda x: jc.contact.ContactForce(HERTZ, x), NOT_NONE),
    ("ContactForce", "memory", lambda x: jc.contact.ContactForce(HERTZ, None, x), NOT_NONE),
    ("Variable", "where", lambda x: jc.Variable(x, tolerance=1e-5), PARTS),
    ("Variable", "tolerance", lambda x: jc.Variable(clearance, tolerance=x), POSITIVE),
    ("Variable", "distribution", lambda x: jc.Variable(clearance, x), NOT_NONE),
    ("Problem", "mechanism", lambda x: draft(mechanism=x), PARTS),
    ("Problem", "response", lambda x: draft(response=x), PARTS | {"empty": {}}),
    ("Problem", "variable", lambda x: draft(variables=x), MAPPING | {"value": {"c": 3}}),
    ("Problem", "duration", lambda x: draft(duration=x), POSITIVE | {"none": None}),
    ("Problem", "save", lambda x: draft(save=x), SAVE),
    ("Problem", "integrator", lambda x: draft(integrator=x), NOT_NONE),
    ("monte_carlo", "sampled", lambda x: jc.monte_carlo(x, 4), PARTS),
    ("monte_carlo", "samples", lambda x: jc.monte_carlo(problem(), x), KINDS["count"]),
    ("monte_carlo", "seed", lambda x: jc.monte_carlo(problem(), 4, seed=x), KINDS["seed"]),
    ("monte_carlo", "sampling", lambda x: jc.monte_carlo(problem(), 4, sampling=x), KINDS["word"]),
    ("monte_carlo", "chunk", lambda x: jc.monte_carlo(problem(), 4, chunk=x), KINDS["count"]),
    ("sensitivity", "differentiated", lambda x: jc.sensitivity(x, sample=4), PARTS),
    ("sensitivity", "variable", lambda x: sensitivity(variables=x), {"name": "b", "number": 3}),
    ("sensitivity", "sample", lambda x: sensitivity(sample=x), KINDS["count"]),
    ("sensitivity", "difference", lambda x: sensitivity(difference_samples=x), KINDS["count"]),
    ("sensitivity", "statistic", lambda x: sensitivity(of=x), {"text": "magic", "number": 3}),
    ("sensitivity", "method", lambda x: sensitivity(methods=x), PARTS | {"empty": ()}),
    ("sensitivity", "seed", lambda x: sensitivity(seed=x), KINDS["seed"]),
    ("advise", "advice", lambda x: jc.advise(x), PARTS),
    (
        "advise",
        "accuracy",
        lambda x: jc.advise(problem(), x),
        POSITIVE | {"one": 1.0, "none": None},
    ),
    ("advise", "pilot", lambda x: jc.advise(problem(), pilot=x), NOT_NONE),
    ("pointing_error", "pointing_error", lambda x: jc.pointing_error(x, "rod"), PARTS),
    ("pointing_error", "tip", lambda x: jc.pointing_error(run(), x), PARTS | {"other": "rodd"}),
    ("pointing_error", "base", lambda x: pointing(base=x), KINDS["word"]),
    ("pointing_error", "through", lambda x: pointing(through=x), KINDS["word"]),
    ("combined_modulus", "combined", lambda x: jc.material.combined_modulus(x, STEEL), PARTS),
    ("fitted", "shape", lambda x: jc.stiffness.fitted(HERTZ, x), PARTS),
    ("four_bar", "kind", lambda x: jc.scenes.four_bar(x), KINDS["word"]),
    ("four_bar", "clearance", lambda x: jc.scenes.four_bar(clearance=x), POSITIVE),
    ("four_bar", "speed", lambda x: jc.scenes.four_bar(crank_speed=x), KINDS["number"]),
    ("four_bar", "friction", lambda x: jc.scenes.four_bar(friction=x), KINDS["flag"]),
    ("four_bar", "wear", lambda x: jc.scenes.four_bar(wear=x), KINDS["flag"]),
    ("four_bar", "cells", lambda x: jc.scenes.four_bar(cells=x), KINDS["word"]),
    ("four_bar", "offset", lambda x: jc.scenes.four_bar(follower_offset=x), KINDS["number"]),
    ("slider_crank", "joint", lambda x: jc.scenes.slider_crank(x), KINDS["word"]),
    ("slider_crank", "clearance", lambda x: jc.scenes.slider_crank(clearance=x), POSITIVE),
    ("slider_crank", "contact", lambda x: jc.scenes.slider_crank(contact=x), NOT_NONE),
    ("slider_crank", "friction", lambda x: jc.scenes.slider_crank(friction=x), NOT_NONE),
    ("slider_crank", "wear", lambda x: jc.scenes.slider_crank(wear=x), NOT_NONE),
    ("slider_crank", "drive", lambda x: jc.scenes.slider_crank(drive=x), NOT_NONE),
    ("slider_crank", "gravity", lambda x: jc.scenes.slider_crank(gravity=x), KINDS["number"]),
    ("guide", "kind", lambda x: jc.scenes.guide(x), KINDS["word"]),
    ("guide", "friction", lambda x: jc.scenes.guide(friction=x), NOT_NONE),
    ("guide", "drive", lambda x: jc.scenes.guide(drive=x), NOT_NONE),
    ("guide", "crank_angle", lambda x: jc.scenes.guide(crank_angle=x), KINDS["number"]),
    ("antenna", "kind", lambda x: jc.scenes.antenna(x), KINDS["word"]),
    ("antenna", "drive", lambda x: jc.scenes.antenna(drive=x), PARTS),
    ("antenna", "friction", lambda x: jc.scenes.antenna(friction=x), NOT_NONE),
    ("antenna", "offset", lambda x: jc.scenes.antenna(offset=x), KINDS["number"]),
    ("run.body", "body", lambda x: run().body(x), KINDS["word"]),
    ("run.contact", "joint", lambda x: run().contact(x), KINDS["word"]),
    ("run.reaction", "joint", lambda x: run().reaction(x), KINDS["word"]),
    ("run.coordinate", "joint", lambda x: run().coordinate(x), KINDS["word"]),
    ("run.speed", "joint", lambda x: run().speed(x), KINDS["word"]),
    ("run.situations", "joint", lambda x: run().situations(x), KINDS["word"]),
    ("run.worn_depth", "joint", lambda x: run().worn_depth(x, "bearing"), KINDS["word"]),
    ("run.worn_volume", "surface", lambda x: run().worn_volume("B", x), KINDS["word"]),
    ("run.marker", "at", lambda x: run().marker("rod", x), KINDS["vector"]),
    (
        "plot.displacement",
        "body",
        lambda x: plot.displacement({"r": run()}, run(), x),
        KINDS["word"],
    ),
    ("plot.displacement", "run", lambda x: plot.displacement(x, run(), "rod"), PARTS),
    ("plot.angular_velocity", "run", lambda x: plot.angular_velocity(x, run(), "rod"), PARTS),
    ("plot.journal_ends", "joint", lambda x: plot.journal_ends(run(), x), KINDS["word"]),
    ("plot.end_centres", "joint", lambda x: plot.end_centres(run(), x), KINDS["word"]),
    ("plot.wear_unrolled", "joint", lambda x: plot.wear_unrolled(run(), x), KINDS["word"]),
    ("plot.wear_surface", "surface", lambda x: plot.wear_surface(run(), "B", x), KINDS["word"]),
    ("plot.monte_carlo", "study", lambda x: plot.monte_carlo(x), PARTS),
    ("plot.sensitivity", "study", lambda x: plot.sensitivity(x), PARTS),
    ("plot.work_precision", "advice", lambda x: plot.work_precision(x), PARTS),
    ("plot.pointing_budget", "error", lambda x: plot.pointing_budget(x), PARTS),
    (
        "LCP",
        "matrix",
        lambda x: jc.complementarity.LCP(x, np.ones(2)),
        {"text": "x", "shape": ONES},
    ),
    ("InteriorPoint.solve", "solver", lambda x: jc.complementarity.InteriorPoint().solve(x), PARTS),
]
REVOLUTE, HERTZ = jc.joint.Revolute(), jc.contact.elastic.Hertz()


def short(**how: Any) -> jc.Trajectory:
    return jc.simulate(rig(), 1e-3, **how)


def pointing(**how: Any) -> Any:
    return jc.pointing_error(run(), "rod", **how)


def changed(**changes: Any) -> jc.Mechanism:
    """The slider-crank with an argument changed."""
    return jc.Mechanism(rig().bodies, rig().connections, **changes)


def sensitivity(**changes: Any) -> Any:
    return jc.sensitivity(problem(), **({"sample": sample(), "difference_samples": 4} | changes))


def cases() -> Iterator[Case]:
    """Every wrong value of every argument."""
    for function, argument, call, values in TABLE:
        for label, value in values.items():
            if (function, argument, label) in ALLOWED:
                continue
            yield Case(
                "functions",
                f"{function}({argument}: {label})",
                functools.partial(call, value),
                (argument, function.rpartition(".")[2]),
            )


# What an argument takes though its kind does not, and why.
ALLOWED = {
    ("run.situations", "joint", "text"),
    ("Marker", "at", "none"),
    ("guide", "friction", "none"),
    ("four_bar", "cells", "none"),
    ("pointing_error", "through", "list"),  # a list of names is names; "a" is refused as unknown
    ("Connection", "axis", "text"),  # an axis by a word
    ("advise", "scales", "list"),  # an empty list
    ("LCP", "matrix", "none"),
}
