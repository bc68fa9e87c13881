"""Stability at the extremes: every rung with every joint, one number at a time taken to where no
mechanism is, and a few at once.

    python -m benchmarks.claims.extremes [--quick] [--json FILE] [--joint NAME ...] [--rung ...]
        [--kept FILE]

A body of 1 kg is pressed into its joint with 100 N, turns (in a guide: slides), and carries a
lighter or heavier arm on a hinge. Each run is judged as in `benchmarks.attack`: right within the
accuracy of its rung, said so (a warning that concerns what is off), refused (a sentence before the
run, or an early end), undecidable (the references, tight, tighter, and off in the fifth digit,
disagree), or silently wrong. What `--kept` finds in its file is not run again, and what is run is
added to it.
"""

import argparse
import json
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

import jaxclear as jc
from benchmarks.attacks.attempts import Asked, Finding, attempt, find, judges
from benchmarks.attacks.bearings import Case
from benchmarks.attacks.kept import keep, known
from benchmarks.attacks.verdicts import Verdict
from benchmarks.measure import about, report

# What nobody would call extreme. Clearance [m], stiffness [N/m^1.5], mass of the arm beside that of
# the body [1], speed [rpm], step [s] (None: the rung's own), restitution, mu [1], deepest wear
# beside the clearance [1].
USUAL: dict[str, Any] = {
    "clearance": 1e-4,
    "stiffness": 1e9,
    "mass ratio": 0.1,
    "speed": 100.0,
    "step": None,
    "restitution": 0.8,
    "mu": 0.1,
    "worn depth": 0.0,
    "wears": True,
    "rubs": True,
}
# Joints that always touch do not wear, and balls among them do not rub.
PERMANENT: dict[str, dict[str, Any]] = {"ball": {"wears": False, "rubs": False}}
UNITS = {"clearance": "m", "stiffness": "N/m^1.5", "speed": "rpm", "step": "s"}
AXES: dict[str, tuple[float, ...]] = {
    "clearance": (1e-6, 1e-5, 1e-3),
    "stiffness": (1e6, 1e8, 1e10, 1e12),
    "mass ratio": (1e-4, 1e-2, 1e2, 1e4),
    "speed": (1.0, 1e3, 1e4, 1e5),
    "step": (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2),
    "restitution": (0.01, 0.5, 1.0),
    "mu": (0.0, 0.5, 1.5),
    "worn depth": (0.1, 0.5, 1.0),
}
CORNERS: tuple[dict[str, float], ...] = (
    {"clearance": 1e-6, "stiffness": 1e12},
    {"clearance": 1e-3, "stiffness": 1e6, "speed": 1e4},
    {"stiffness": 1e12, "mu": 1.5, "restitution": 0.01},
    {"clearance": 1e-3, "restitution": 1.0, "mu": 0.0, "speed": 1e4},
)
QUICK_AXES = ("clearance", "step")
MASS, LOAD, RADIUS, LENGTH = 1.0, 100.0, 10e-3, 20e-3
ARM, HINGE = 0.1, 0.05
# Saving times lie as far apart as the longest step.
DURATION, SAVES = 0.05, 6
RPM = 2 * jnp.pi / 60
I = jc.integrator  # noqa: E741


class Rung(NamedTuple):
    """An integrator whose step is a number, and of which model it is."""

    integrator: Any
    model: str = "compliant"


def rungs() -> dict[str, Rung]:
    """The rungs as they come; a step is put in where one is varied."""
    return {
        "Adaptive": Rung(I.Adaptive()),
        "FixedStep": Rung(I.FixedStep()),
        "semi_implicit": Rung(I.FixedStep(1e-5, "semi_implicit")),
        "contact_steps": Rung(I.FixedStep(1e-4, contact_steps=20)),
        "ImplicitStep": Rung(I.ImplicitStep()),
        "MoreauJean": Rung(I.MoreauJean(), "rigid"),
        "NonColliding": Rung(I.NonColliding(), "permanent"),
    }


def _law(p: dict) -> tuple[Any, Any]:
    contact = jc.contact.CarvalhoMartins(stiffness=p["stiffness"], restitution=p["restitution"])
    if not p["rubs"]:
        return contact, None
    return contact, jc.friction.CoulombTanh(mu_kinetic=p["mu"], transition_speed=1e-2)


def _wearing(p: dict, cells: tuple[int, int]) -> jc.Wearing | None:
    return jc.Wearing(jc.wear.Archard(wear_coefficient=1e-4), cells) if p["wears"] else None


def _planar(p: dict) -> Any:
    return jc.clearance.PlanarJournalBearing(
        *_law(p),
        bearing_radius=RADIUS,
        clearance=p["clearance"],
        length=LENGTH,
        bearing_wear=_wearing(p, (24, 1)),
    )


def _journal(p: dict) -> Any:
    flange = jc.clearance.Flange(*_law(p), radius=1.4 * RADIUS, clearance=2 * p["clearance"])
    return jc.clearance.JournalBearing(
        *_law(p),
        bearing_radius=RADIUS,
        clearance=p["clearance"],
        length=LENGTH,
        flange=flange,
        bearing_wear=_wearing(p, (24, 4)),
    )


def _ball(p: dict) -> Any:
    return jc.clearance.BallSocket(
        *_law(p), socket_radius=RADIUS, clearance=p["clearance"], socket_wear=_wearing(p, (16, 8))
    )


def _guide(p: dict) -> Any:
    return jc.clearance.SliderGuide(
        *_law(p), width=2 * RADIUS, length=4 * RADIUS, clearance=p["clearance"]
    )


def _bodies(flat: bool, p: dict) -> dict[str, jc.Body]:
    def body(mass: float, com: tuple) -> jc.Body:
        size = mass * 1e-3
        return jc.Body(mass, size if flat else (size, 2 * size, 1.5 * size), com)

    place = (0.0, 0.0) if flat else (0.0, 0.0, 2e-3)
    arm = (ARM, 0.0) if flat else (ARM, 0.0, 0.0)
    return {"body": body(MASS, place), "arm": body(MASS * p["mass ratio"], arm)}


def pressed(joint: Callable, flat: bool, along: bool) -> Callable[[dict], Case]:
    """The rig of a joint with clearance; `along`: the joint slides instead of turning."""

    def build(p: dict) -> Case:
        omega = float(p["speed"] * RPM)
        axis = "x" if along else "z"
        speed = (omega * RADIUS, 0.0, 0.0) if along else (0.0, 0.0, omega)
        push = (0.1 * LOAD, -LOAD) if flat else (0.1 * LOAD, -LOAD, 0.02 * LOAD)
        rig = jc.Mechanism(
            _bodies(flat, p),
            {
                "B": jc.Connection(
                    joint(p), jc.Marker("ground", axis=axis), jc.Marker("body", axis=axis)
                ),
                "hinge": jc.Connection(jc.joint.Revolute(), "body", "arm", at=(HINGE, 0.0)),
            },
            {"load": jc.load.Force(jc.Marker("body"), push), "gravity": jc.load.Gravity()},
            speeds={"body": speed if flat else (0.0, 0.0, 0.0, *speed)},
        )
        return Case(rig, DURATION)

    return build


def loop(p: dict) -> Case:
    """A driven slider-crank without clearance, the slider's mass varied."""
    scene = jc.scenes.slider_crank("ideal", crank_speed=float(p["speed"] * RPM))
    bodies = scene.bodies | {"slider": jc.Body(0.3 * p["mass ratio"], 1e-4)}
    rig = jc.Mechanism(bodies, scene.connections, scene.loads, start={"G": 0.17})
    return Case(rig, DURATION)


# Joint: how its rig is built, and the numbers that it does not have.
JOINTS: dict[str, tuple[Callable[[dict], Case], tuple[str, ...]]] = {
    "planar": (pressed(_planar, True, False), ()),
    "journal": (pressed(_journal, False, False), ()),
    "ball": (pressed(_ball, False, False), ()),
    "guide": (pressed(_guide, True, True), ("worn depth",)),
    "loop": (
        loop,
        ("clearance", "stiffness", "restitution", "mu", "worn depth"),
    ),
}


class Cell(NamedTuple):
    """One run: joint, rung, what was taken to an extreme, and what was found."""

    joint: str
    rung: str
    varied: dict[str, float]
    found: Finding


def variations(joint: str, quick: bool) -> list[dict[str, float]]:
    """What is varied for a joint: nothing, each number in turn, some at once."""
    lacking = JOINTS[joint][1]
    found: list[dict[str, float]] = [{}]
    for axis, values in AXES.items():
        if axis not in lacking and (not quick or axis in QUICK_AXES):
            found += [{axis: value} for value in (values[::2] if quick else values)]
    return found + [c for c in CORNERS if not quick and not set(c) & set(lacking)]


def asked_of(joint: str, p: dict) -> Asked:
    """Worn surfaces enter by another door, so fresh ones do too where the joint wears."""
    wears = p["wears"] and "worn depth" not in JOINTS[joint][1]
    return Asked(SAVES, True, p["worn depth"] * p["clearance"] if wears else None)


def cells(joint: str, options: argparse.Namespace) -> list[Cell]:
    """All runs of one joint, those that are kept taken from there."""
    found, made = known(options.kept, Cell), []
    for varied in variations(joint, options.quick):
        key = " | ".join((joint, in_words(varied), *options.rung))
        if key not in found:
            found[key] = cells_of(joint, varied, options.rung)
            keep(options.kept, key, found[key])
        made += found[key]
    return made


def cells_of(joint: str, varied: dict[str, float], names: list[str]) -> list[Cell]:
    """All runs of a joint with its numbers. References are made once for every model."""
    made = []
    references: dict[str, tuple] = {}
    for name in names:
        rung = rungs()[name]
        p = USUAL | varied
        if rung.model == "permanent":
            p |= {"wears": False} | PERMANENT.get(joint, {})
        lacks = "step" in varied and name == "Adaptive"
        if lacks or (varied.get("worn depth") and not p["wears"]):
            continue
        case, asked = JOINTS[joint][0](p), asked_of(joint, p)
        integrator = with_step(rung.integrator, p["step"])
        if rung.model not in references:
            length = None if rung.model == "compliant" else float(integrator.step)
            references[rung.model] = judges(case, rung.model, length, asked)
        run = attempt(case, integrator, asked)
        made.append(
            Cell(joint, name, varied, find(run, references[rung.model], integrator.promise))
        )
    return made


def with_step(integrator: Any, step: float | None) -> Any:
    """The integrator with another step [s]; None: its own."""
    if step is None:
        return integrator
    return eqx.tree_at(lambda i: i.step, integrator, jnp.asarray(step, float))


LETTERS = {
    Verdict.RIGHT: "R",
    Verdict.SAID: "S",
    Verdict.REFUSED: "E",
    Verdict.UNDECIDABLE: "U",
    Verdict.UNSAID: "u",
    Verdict.NO_REFERENCE: "n",
    Verdict.WRONG: "W",
    Verdict.RAW: "X",
}


def in_words(varied: dict[str, float]) -> str:
    """What was varied, with units."""
    parts = [f"{name} {value:g} {UNITS.get(name, '')}".strip() for name, value in varied.items()]
    return ", ".join(parts) or "nothing"


def by_extreme(found: list[Cell]) -> list[dict[str, Any]]:
    """A row for every variation, a column for every rung: a letter for every joint."""
    rows = []
    for words in dict.fromkeys(in_words(cell.varied) for cell in found):
        row = {"varied": words}
        for name in dict.fromkeys(cell.rung for cell in found):
            own = {c.joint: c for c in found if (c.rung, in_words(c.varied)) == (name, words)}
            row[name] = " ".join(
                LETTERS[own[joint].found.verdict] if joint in own else "-" for joint in JOINTS
            )
        rows.append(row)
    return rows


def by_joint(found: list[Cell]) -> list[dict[str, Any]]:
    """A row for every joint and rung, how many runs were what."""
    rows = []
    names = dict.fromkeys((cell.joint, cell.rung) for cell in found)
    for joint, rung in [*names, ("all", "all")]:
        own = [c for c in found if joint in (c.joint, "all") and rung in (c.rung, "all")]
        counts = Counter(cell.found.verdict for cell in own)
        rows.append(
            {"joint": joint, "rung": rung, "runs": len(own)}
            | {str(verdict): counts[verdict] for verdict in LETTERS}
        )
    return rows


def accused(found: list[Cell]) -> list[dict[str, Any]]:
    """What is wrong without a sentence."""
    bad = (Verdict.WRONG, Verdict.UNSAID, Verdict.RAW)
    rows = []
    for cell in found:
        if cell.found.verdict in bad:
            off = [
                f"{name} {cell.found.errors[name]:.2g} (+-{cell.found.doubts[name]:.1g})"
                for name, verdict in cell.found.verdicts.items()
                if verdict in bad
            ]
            rows.append(
                {"joint": cell.joint, "rung": cell.rung, "varied": in_words(cell.varied)}
                | {"verdict": str(cell.found.verdict)}
                | {"off by": ", ".join(off) or " ".join(cell.found.said)[:100]}
            )
    return rows


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="clearance and step only")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures here")
    parser.add_argument("--joint", nargs="*", choices=JOINTS, default=list(JOINTS))
    parser.add_argument("--rung", nargs="*", choices=rungs(), default=list(rungs()))
    parser.add_argument("--kept", type=Path, metavar="FILE", help="runs that are done, as lines")
    return parser.parse_args()


def main() -> None:
    options = _options()
    found: list[Cell] = []
    told = {"about": about("benchmarks.claims.extremes", options.json)}
    for joint in options.joint:
        begun = time.process_time()
        own = cells(joint, options)
        found += own
        counts = Counter(str(cell.found.verdict) for cell in own)
        print(f"{joint}: {dict(counts)} ({time.process_time() - begun:.0f} s CPU)", flush=True)
        for row in accused(own):
            print("    ", " | ".join(str(value) for value in row.values()), flush=True)
        jax.clear_caches()
    if options.json:
        options.json.write_text(json.dumps(told, indent=1) + "\n")
    legend = ", ".join(f"{letter}: {verdict}" for verdict, letter in LETTERS.items())
    report(
        f"extremes by what is varied ({', '.join(JOINTS)}; {legend})", by_extreme(found), options
    )
    report("extremes by joint", by_joint(found), options)


if __name__ == "__main__":
    main()
