"""What is written is read again as it was, leaf by leaf: every class of every family that a file
may name, and every ready mechanism. A new class is covered the moment it is defined.

The JSON schema of scene files says what reading says, as far as a schema can, and the published
one is current. `python -m tests.files.test_round_trip` writes it anew.
"""

import functools
import json
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import jsonschema
import numpy as np
import pytest

import jaxclear as jc
import jaxclear.studies.identification.laws  # classes of the package that load late
from jaxclear.files.forms import (
    ByName,
    Choice,
    Flag,
    Integer,
    Listed,
    Number,
    NumberArray,
    Numbers,
    Place,
    Text,
)
from jaxclear.files.parts import Part, arguments, final_classes
from jaxclear.files.scene import RUN, TOP, scene_text
from jaxclear.files.text import parse_values
from jaxclear.studies.position_problem import PositionExperiment
from jaxclear.studies.store.digest import difference, in_texts

# Numbers that bound each other, words of a few, and what only fits together.
TOGETHER = {
    "low": -1.0,
    "high": 1.0,
    "mode": 0.25,
    "deviations": [-1.0, 0.5],
    "shares": [0.25, 0.75],
    "outer_radius": 0.5,
    "inner_radius": 0.25,
    "inner_diameter": 0.25,
    "outer_diameter": 0.5,
    "GJ": 0.5,
    "turning_inertia": 0.5,
    "EA": 0.5,
    "bearing_radius": 0.5,
    "socket_radius": 0.5,
    "width": 0.5,
    "clearance": 0.01,
    "journal_length": 2.0,
    "length": 1.5,
    "radius": 0.75,
    "mu_static": 0.75,
    "mu_kinetic": 0.5,
    "static_speed": 0.25,
    "kinetic_speed": 0.75,
    "inner_speed": 0.25,
    "outer_speed": 0.75,
    "stribeck_speed": 1.5,
    "roundness": None,
    "film": None,
    "poisson_ratio": 0.375,
    "bound": 2.0,
    "method": "heun",
    "coarseness": 2.0,
    "contact_steps": None,
    "steps_per_save": 7,
    "axes": [0, 2],
    "reference": [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]],
    "inertia": [2.0, 2.5, 3.0, 0.1, 0.2, 0.3],
    "com": [0.25, 0.5, 0.75],
    "at": [0.25, 0.5, 0.75],
    "axis": [0.25, 0.5, 0.75],
    "quaternion": None,
    "cells": [12, 3],
    "where": 'bodies["crank"].mass',
    "solver": "Tsit5",
    "unit": "m",
    "number": 3,
}
# Of one class only.
ONE_TURN = {
    "kind": "TimeTable",
    "times": [0.0, 2.0, 4.0, 2 * np.pi],
    "values": [0.0, 1.0, 0.5, 0.0],
    "beyond": "repeated",
}
# A zone is on a marker, round or between planes.
ZONE = {"marker": "A.parent", "along": "x", "spherical": False, "width": None, "at_lmc": None}
LEANS = ("Angularity", "Parallelism", "Perpendicularity")
# Surfaces of ideal joints have no worn radius.
ARCHARD_WEAR = {
    "kind": "Wearing",
    "law": {"kind": "Archard", "wear_coefficient": 1e-4, "hardness": 2e9},
}
OWN = {
    ("PlainBearing", "wear"): ARCHARD_WEAR,
    ("Slideway", "wear"): ARCHARD_WEAR,
    ("BallJoint", "wear"): ARCHARD_WEAR,
    ("KelvinVoigt", "stiffness"): "number",
    ("MobileJournal", "film"): {
        "kind": "JournalFilm",
        "connection": "crank",
        "law": {"kind": "Reynolds"},
        "radius": 0.5,
        "clearance": 0.01,
        "length": 1.5,
    },
    ("Belt", "play"): None,
    ("Cam", "profile"): ONE_TURN,
    ("Gear", "transmission_error"): ONE_TURN,
    ("Rope", "over"): ["crank", "rod"],
    ("Servo", "reference"): 0.5,
    ("Servo", "encoder"): "load",
    ("Motor", "inertia"): 0.5,
    ("Position", "function"): {"kind": "PeriodicTorque", "amplitude": 0.5},
    ("Force", "value"): [1.0, 2.0, 3.0],
    ("Connection", "axis"): None,
    ("Connection", "at"): None,
    ("Variable", "tolerance"): None,
    ("Condition", "tolerance"): None,
    ("Condition", "acts"): {"kind": "Heating", "expansion": {"crank": 1e-5, "rod": 2e-5}},
    ("Heating", "expansion"): {"crank": 1e-5, "rod": 2e-5},
    ("JointStop", "lower"): -0.5,
    ("JointStop", "upper"): 0.5,
    ("Empirical", "deviations"): [-1.0, 0.0, 2.0],
    ("Empirical", "low"): -3.0,
    ("Empirical", "high"): 3.0,
    ("FromScipy", "scipy"): None,
    ("FromScipy", "numbers"): None,
    ("FromScipy", "about"): None,
    ("FromScipy", "spread"): 0.5,
    ("FromScipy", "table"): {"scores": [-1, 0, 1], "deviations": [-2, 0, 2], "slopes": [2, 2, 2]},
    ("ContactForce", "memory"): None,
    ("ContactForce", "dissipation"): {"kind": "LankaraniNikravesh", "restitution": 0.75},
    ("Fit", "fit"): "20 H7/g6",
    ("Capability", "cp"): 1.5,
    ("Capability", "cpk"): 1.0,
    ("Capability", "distribution"): "normal",
    ("LargestError", "body"): None,
    ("LargestError", "axis"): 1,
    ("LargestError", "reference"): [0.0, 1.0],
    ("SliderGuide", "guide_length"): 4.0,
    ("SliderGuide", "guide_wear"): {"law": {"kind": "Archard"}},
    ("SliderGuide", "slider_wear"): {"law": {"kind": "Archard"}},
    ("State", "motion"): None,
    ("TimeTable", "csv"): None,
    ("TimeTable", "columns"): None,
    ("TimeTable", "times"): [0.0, 0.25, 0.5, 1.0],
    ("TimeTable", "values"): [0.0, 1 / 3, 2.0, 0.0],
    ("TimeTable", "interpolation"): "monotone",
    ("TimeTable", "beyond"): "straight",
}
OWN |= {("Coaxiality", name): own for name, own in ZONE.items()}
OWN |= {(zone, name): own for zone in LEANS for name, own in (ZONE | {"width": 0.5}).items()}


def classes_of_package(families):
    """Classes that other test files define count as read by a file, too, but are no part of it."""
    return {
        name: kind
        for name, kind in final_classes(families).items()
        if kind.__module__.startswith("jaxclear.")
    }


def reachable():
    """Every class that a scene file may name, with a field form under which it stands."""
    left, found = [*TOP.values(), *RUN.values()], {}
    while left:
        form = left.pop()
        if isinstance(form, (Choice,)):
            left += form.forms
        elif isinstance(form, (ByName, Listed)):
            left.append(form.entry)
        elif isinstance(form, Part):
            for name, kind in classes_of_package(form.families).items():
                if name not in found:
                    found[name] = (kind, Part(form.families))
                    left += [own.form for own in arguments(kind).values() if own.form is not None]
    return found


REACHABLE = reachable()


def within(metadata):
    low = max(metadata.get("above", -np.inf), metadata.get("at_least", -np.inf))
    high = min(metadata.get("below", np.inf), metadata.get("at_most", np.inf))
    if np.isfinite(low) and np.isfinite(high):
        return 0.375 * low + 0.625 * high
    return low + 1.1 if np.isfinite(low) else min(high, 0.7)


@functools.singledispatch
def sample(form, depth):
    """Plain values of a form."""
    raise NotImplementedError(type(form).__name__)


@sample.register
def _(form: Number, depth):
    return within(form.metadata)


@sample.register
def _(form: Numbers, depth):
    return [within(form.metadata) + 0.125 * k for k in range(max(form.counts, default=2))]


@sample.register
def _(form: NumberArray, depth):
    return [0.25, 1 / 3, 0.75]


@sample.register
def _(form: Integer, depth):
    return form.metadata.get("at_least", 1) + 1


@sample.register
def _(form: Flag, depth):
    return True


@sample.register
def _(form: Text, depth):
    return "crank"


@sample.register
def _(form: Listed, depth):
    return [sample(form.entry, depth)] * (form.length or 1)


@sample.register
def _(form: ByName, depth):
    return {"crank": sample(form.entry, depth)}


@sample.register
def _(form: Choice, depth):
    return sample(form.forms[depth % len(form.forms)], depth)


@sample.register
def _(form: Part, depth):
    return of_class(next(iter(classes_of_package(form.families).values())), depth + 1)


@sample.register
def _(form: Place, depth):
    return 'bodies["crank"].mass'


def of_class(kind, depth=0):
    """Plain values of every argument of a class."""
    found = {"kind": kind.__name__}
    for name, own in arguments(kind).items():
        if (kind.__name__, name) in OWN:
            value = OWN[kind.__name__, name]
            value = within(own.metadata) if value == "number" else value
        elif name in TOGETHER and own.form is not None:
            value = TOGETHER[name]
        elif own.form is None or (depth > 6 and not own.needed):
            continue
        else:
            value = sample(own.form, depth)
        if value is not None:
            found[name] = value
    return found


def as_node(values):
    return parse_values(json.dumps(values), ".json")


def assert_same(one, other):
    """Leaf by leaf, static fields too."""
    assert type(one) is type(other)
    if isinstance(one, jc.Saving):
        assert np.array_equal(one.at, other.at) and one.events == other.events
    elif isinstance(one, eqx.Module):
        assert eqx.tree_equal(one, other, typematch=True)
    else:
        assert one == other


MECHANISM = jc.scenes.slider_crank()


def test_every_family_has_members():
    """The walk over the forms of a scene finds what a file is for."""
    assert {"Body", "Marker", "Connection", "Mechanism", "Revolute", "JournalBearing"} <= {
        *REACHABLE
    }
    for family in (
        jc.joint.AbstractJoint,
        jc.clearance.AbstractClearance,
        jc.drive.AbstractDrive,
        jc.load.AbstractLoad,
        jc.contact.AbstractNormalLaw,
        jc.contact.AbstractElasticForce,
        jc.contact.AbstractDissipation,
        jc.friction.AbstractFrictionLaw,
        jc.wear.AbstractWearLaw,
        jc.stiffness.AbstractFit,
        jc.integrator.AbstractIntegrator,
        jc.distribution.AbstractDistribution,
        jc.response.AbstractResponse,
    ):
        own = {
            n for n, k in final_classes((family,)).items() if k.__module__.startswith("jaxclear")
        }
        assert own and own <= {*REACHABLE}, family


def test_a_users_class_hides_none_of_the_package_and_its_last_definition_counts():
    class Family(eqx.Module):
        pass

    def define():
        class Spring(Family):
            pass

        return Spring

    kinds = [define(), define()]
    assert final_classes((Family,))["Spring"] is kinds[1]
    assert final_classes((Family, jc.load.AbstractLoad))["Spring"] is jc.load.Spring


def test_every_argument_of_every_class_has_a_file_form():
    # What a run hands to its own solver stands in no file.
    known = {
        "Variable": ["derived"],
        "TakingImpactSpeeds": ["motion", "derived", "growth", "so_far"],
        # A function is code.
        "FromFunction": ["function"],
    }
    lacking = {
        name: [n for n, own in arguments(kind).items() if own.form is None]
        for name, (kind, _) in REACHABLE.items()
    }
    assert {name: own for name, own in lacking.items() if own} == known


@pytest.mark.parametrize("name", sorted({*REACHABLE} - {"Mechanism", "FromFunction"}))
def test_every_class_is_read_as_it_was_written(name, tmp_path):
    kind, form = REACHABLE[name]
    built = form.read(as_node(of_class(kind)), "here", tmp_path)
    assert type(built) is kind
    written = form.plain(built, "here", MECHANISM)
    again = form.read(as_node(written), "here", tmp_path)
    assert_same(built, again)
    assert form.plain(again, "here", MECHANISM) == written


SCENES = {name: getattr(jc.scenes, name) for name in jc.scenes.__all__}
FURTHER = {
    "planar four-bar": lambda: jc.scenes.four_bar("planar"),
    "ideal four-bar": lambda: jc.scenes.four_bar("ideal"),
    "step-driven antenna": lambda: jc.scenes.antenna(drive="step"),
    # Its markers lie on the beam in the file, on pieces of it in the mechanism.
    "slider-crank with a beam": lambda: jc.scenes.slider_crank().with_body(
        "rod", jc.Beam(0.12, jc.section.Circle(6e-3), jc.material.steel(), 7850.0, 4, space=False)
    ),
    "slider-crank on a film": lambda: jc.scenes.slider_crank(
        jc.clearance.PlanarJournalBearing(
            jc.contact.Hertz(),
            film=jc.film.Reynolds(viscosity=jc.film.Vogel(6e-5, 1030.0, 153.6, 313.0)),
        )
    ),
    "with numbers changed": lambda: eqx.tree_at(
        lambda m: m.bodies["rod"].mass, jc.scenes.slider_crank(), jnp.asarray(1 / 3)
    ),
}


@pytest.mark.parametrize("name", [*SCENES, *FURTHER])
def test_every_ready_mechanism_is_read_as_it_was_written(name, tmp_path):
    mechanism = (SCENES | FURTHER)[name]()
    for path in (tmp_path / "scene.yaml", tmp_path / "scene.json"):
        jc.write_scene(mechanism, path)
        again = jc.read_scene(path).mechanism
        assert eqx.tree_equal(mechanism, again, typematch=True)
        assert again.topology == mechanism.topology


def asked():
    """A scene that states all that a scene may."""
    mechanism = jc.scenes.slider_crank(wear=True)
    return jc.Scene(
        mechanism,
        0.01,
        jc.integrator.FixedStep(1e-5),
        jc.Saving(11, events=3),
        jc.State(concentric=False),
        variables={
            "clearance": jc.Variable(lambda m: m.connections["B"].joint.clearance, tolerance=1e-5),
            "masses": jc.Variable(
                lambda m: [m.bodies["rod"].mass, m.bodies["crank"].mass],
                jc.distribution.Uniform(1e-3),
            ),
        },
        responses={"force": jc.response.PeakContactForce("B")},
        correlation={("clearance", "masses"): 0.25},
        description="All that a scene may state.",
    )


def written_and_read(scene, path):
    """The scene that a file holds, which says the same."""
    jc.write_scene(scene, path)
    again = jc.read_scene(path)
    assert scene_text(again) == scene_text(scene)
    return again


def asked_over_positions():
    """A scene without time: where a four-bar stands, warmer or colder, with play in one joint."""
    rig = jc.scenes.four_bar("planar")
    return jc.Scene(
        rig,
        positions={rig.driven[0]: np.linspace(0.0, 1.0, 3)},
        reverse_loads=True,
        variables={
            "clearance": jc.Variable(lambda m: m.connections["B"].joint.clearance, tolerance=1e-5),
            "warmth": jc.Condition(
                jc.Heating({"coupler": 11.5e-6, "crank": 23e-6}), 0.0, tolerance=40.0
            ),
        },
        responses={"lost": jc.response.LostMotion("D")},
    )


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".yaml", ".json"])
def test_a_scene_over_positions_asks_the_same_after_it_was_written(ending, tmp_path):
    scene = asked_over_positions()
    again = written_and_read(scene, tmp_path / f"scene{ending}")
    one, other = scene.problem(), again.problem()
    assert isinstance(one.experiment, PositionExperiment)
    assert in_texts(other) == in_texts(one)
    stood = one.detail(one.nominal())
    np.testing.assert_array_equal(again.stand().body("coupler").com, stood.body("coupler").com)


def test_a_scene_is_a_run_or_positions(tmp_path):
    rig = jc.scenes.slider_crank()
    for given, sentence in (
        ({"duration": 1.0, "positions": {"O": [0.1]}}, 'positions and "duration"'),
        ({"reverse_loads": True}, "reverse_loads without positions"),
        ({"positions": {"O": [[0.1]]}}, 'positions of joint "O" are .* numbers in a row'),
    ):
        with pytest.raises(ValueError, match=sentence):
            jc.Scene(rig, **given)
    with pytest.raises(ValueError, match="states positions, without time: ask scene.stand"):
        jc.Scene(rig, positions={"O": [0.1]}).simulate()
    with pytest.raises(ValueError, match="states no positions"):
        jc.Scene(rig, 1.0).stand()


def test_what_is_code_is_refused_by_its_place(tmp_path):
    rig = jc.scenes.slider_crank()
    where = lambda m: m.bodies["rod"].mass
    derived = [(lambda m: m.bodies["rod"].inertia, lambda m: m.bodies["rod"].inertia[0])]
    for scene, sentence in (
        (
            jc.Scene(rig, 1.0, variables={"w": jc.Condition(lambda m, x: m, 0.0, tolerance=1.0)}),
            'variables."w".*.acts is the function <lambda>: .* data, no code. Take .*"Heating"',
        ),
        (
            jc.Scene(rig, 1.0, variables={"m": jc.Variable(where, tolerance=0.1, derived=derived)}),
            'variables."m".*.derived is .* holds data, no code',
        ),
        (
            jc.Scene(rig, 1.0, responses={"x": lambda run: run.time[-1]}),
            'responses."x".* is the function <lambda>: a file holds data, no code',
        ),
        (
            rig.with_loads({"f": jc.load.JointTorque("A", lambda t: t)}),
            'loads."f".*.value is the function <lambda>.*jaxclear.TimeTable.sampled',
        ),
        (jc.Problem, "what is written is the class Problem; it must be a jaxclear.Scene"),
    ):
        with pytest.raises(ValueError, match=sentence):
            jc.write_scene(scene, tmp_path / "scene.yaml")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("ending", [".yaml", ".json"])
def test_a_scene_asks_the_same_after_it_was_written(ending, tmp_path):
    """The problem that is read is the one that was written: a store of a study knows it again."""
    scene = asked()
    again = written_and_read(scene, tmp_path / f"scene{ending}")
    assert in_texts(again.problem()) == in_texts(scene.problem())
    assert difference(scene.problem(), again.problem()) == ""


def test_numbers_keep_every_digit(tmp_path):
    """Of 1000 numbers of all sizes: what is read is what was written, bit for bit."""
    draws = np.random.default_rng(0)
    times = np.sort(draws.random(1000)) + 1e-300
    values = draws.standard_normal(1000) * 10.0 ** draws.integers(-300, 300, 1000)
    worn = jc.State({"B": {"bearing": np.stack([times, values])}})
    path = tmp_path / "scene.yaml"
    jc.write_scene(jc.Scene(MECHANISM, 1.0, state=worn), path)
    assert np.array_equal(jc.read_scene(path).state.worn["B"]["bearing"], worn.worn["B"]["bearing"])


# Told by a function, so no file holds it; solvers are diffrax's business.
LEFT_OUT = {
    "Condition",
    "FollowingErrors",
    "FromFunction",
    "MuntheKaas",
    "Stages",
    "FollowingCouplings",
    "StandingAtBounds",
    "TakingImpactSpeeds",
}

PUBLISHED = Path(__file__).parents[2] / "notebooks" / "_static" / "scene.schema.json"


@pytest.fixture(scope="module")
def validator():
    schema = jc.scene_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def text_of_schema():
    return json.dumps(jc.scene_schema(), indent=1, sort_keys=True) + "\n"


def test_published_schema_is_current():
    assert PUBLISHED.read_text() == text_of_schema()


def values(scene):
    return json.loads(scene_text(scene, ".json"))


@pytest.mark.parametrize("name", [*SCENES, *FURTHER, "asked"])
def test_what_is_written_fits_the_schema(validator, name):
    made = {"asked": asked} | SCENES | FURTHER
    scene = made[name]()
    validator.validate(values(scene if isinstance(scene, jc.Scene) else jc.Scene(scene)))


def test_every_class_is_in_the_schema(validator):
    defined = {name.rpartition(".")[2] for name in validator.schema["$defs"]}
    assert {*REACHABLE} - LEFT_OUT <= defined


def test_every_class_as_it_is_read_fits_its_schema(validator):
    defined = validator.schema["$defs"]
    for name in {*REACHABLE} - LEFT_OUT - {"Mechanism"}:
        full = next(place for place in defined if place.rpartition(".")[2] == name)
        schema = {"$ref": f"#/$defs/{full}", "$defs": defined}
        jsonschema.Draft202012Validator(schema).validate(of_class(REACHABLE[name][0]))


@pytest.mark.parametrize(
    "change",
    [
        lambda v: v.pop("mechanism"),
        lambda v: v["mechanism"].pop("bodies"),
        lambda v: v["mechanism"]["bodies"]["rod"].update(mass=-1.0),
        lambda v: v["mechanism"]["bodies"]["rod"].update(mass="heavy"),
        lambda v: v["mechanism"]["bodies"]["rod"].update(weight=1.0),
        lambda v: v["mechanism"]["connections"]["A"].update(joint="Revolut"),
        lambda v: v["mechanism"]["connections"]["B"]["joint"].update(clearance=[1e-4]),
        lambda v: v["mechanism"]["connections"]["B"]["joint"].pop("contact"),
        lambda v: v["run"].update(duration=0.0),
        lambda v: v["run"].update(integrator="Euler"),
        lambda v: v["responses"]["force"].update(kind="Force"),
        lambda v: v.update(jaxclear_scene=2),
    ],
)
def test_what_the_schema_refuses_reading_refuses(validator, change, tmp_path):
    wrong = values(asked())
    validator.validate(wrong)
    change(wrong)
    assert not validator.is_valid(wrong)
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(wrong))
    with pytest.raises(ValueError, match=r"^scene\.json: "):
        jc.read_scene(path)


if __name__ == "__main__":
    PUBLISHED.write_text(text_of_schema())
