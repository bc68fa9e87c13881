"""What is built stays built: parts of a mechanism are read-only, and copies, files and derivatives
go through them as before."""

import copy
import dataclasses
import pickle

import equinox as eqx
import jax
import numpy as np
import pytest

import jaxclear as jc


def arm():
    """Two links; names not in the order of the alphabet."""
    link = jc.Body(1.0, 0.1, (0.5, 0.0))
    return jc.Mechanism(
        {"upper": link, "fore": link},
        {
            "shoulder": jc.Connection(jc.joint.Revolute(), "ground", "upper"),
            "elbow": jc.Connection(jc.joint.Revolute(), "upper", "fore", at=(1.0, 0.0)),
        },
        {"gravity": jc.load.Gravity((0.0, -9.81))},
        couplings={"tie": jc.coupling.Ratio("elbow", "shoulder", 0.3 / 0.7)},
        start={"shoulder": 0.7, "elbow": 0.3},
        speeds={"shoulder": 1.0},
        guess={"fore": (1.0, 0.0, 1.0)},
    )


RIG = arm()
LOAD = jc.load.JointTorque("elbow", 2.0)
BODY = jc.Body(3.0, 0.2, (0.4, 0.0))
PARTS = ("bodies", "connections", "loads", "couplings", "start", "speeds", "guess")
CHANGES = {
    "put": lambda part: part.__setitem__("N", LOAD),
    "delete": lambda part: part.__delitem__(next(iter(part))),
    "update": lambda part: part.update({"N": LOAD}),
    "pop": lambda part: part.pop(next(iter(part))),
    "popitem": lambda part: part.popitem(),
    "clear": lambda part: part.clear(),
    "setdefault": lambda part: part.setdefault("N", LOAD),
    "or in place": lambda part: part.__ior__({"N": LOAD}),
}


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("change", CHANGES)
def test_a_change_in_place_is_refused_with_what_to_do(part, change):
    before = dict(getattr(RIG, part))
    ways = r"read-only.*with_joint.*with_body.*with_load.*mechanism\.start_arguments"
    with pytest.raises(TypeError, match=ways):
        CHANGES[change](getattr(RIG, part))
    assert dict(getattr(RIG, part)) == before


FIELDS = {
    "a body": (BODY, "mass", r"Body is read-only.*replace\(it, mass=.*with_body.*tree_at"),
    "a load": (LOAD, "value", r"load.JointTorque is read-only.*with_load"),
    "a joint": (RIG.connections["elbow"].joint, "drive", r"joint.Revolute is read-only"),
    "a connection": (RIG.connections["elbow"], "joint", r"Connection is read-only.*with_joint"),
    "a marker": (jc.Marker("arm"), "at", "Marker is read-only"),
    "a mechanism": (RIG, "bodies", r"Mechanism is read-only: bodies.*Build another; mechanism"),
    "a slip": (BODY, "mas", 'no field "mas" in Body.*Did you mean "mass"'),
}


@pytest.mark.parametrize("name", FIELDS)
def test_a_field_that_is_set_or_taken_out_is_refused_with_what_to_do(name):
    part, field, sentence = FIELDS[name]
    for change in (lambda: setattr(part, field, 1.0), lambda: delattr(part, field)):
        with pytest.raises(dataclasses.FrozenInstanceError, match=sentence):
            change()


@pytest.mark.parametrize(
    "twin", [lambda m: pickle.loads(pickle.dumps(m)), copy.deepcopy, copy.copy]
)
def test_copies_are_the_same_and_as_read_only(twin):
    again = twin(RIG)
    assert eqx.tree_equal(again, RIG)
    with pytest.raises(TypeError, match="read-only"):
        again.loads["N"] = LOAD


def test_a_union_is_a_plain_dictionary():
    for both in (RIG.loads | {"N": LOAD}, {"N": LOAD} | RIG.loads, RIG.loads.copy()):
        assert type(both) is dict
        both["M"] = LOAD
    assert list(RIG.loads | {"N": LOAD}) == ["gravity", "N"]


def test_a_changed_number_keeps_the_order_of_names_and_their_paths():
    heavier = eqx.tree_at(lambda m: m.bodies["fore"].mass, RIG, 2.0)
    assert list(heavier.bodies) == ["upper", "fore"]
    assert list(heavier.start) == ["shoulder", "elbow"]
    assert float(heavier.bodies["fore"].mass) == 2.0 and float(RIG.bodies["fore"].mass) == 1.0
    doubled = jax.tree.map(lambda x: 2 * x, RIG)
    assert list(doubled.bodies) == ["upper", "fore"]
    paths = [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(RIG)]
    assert paths[0] == ".bodies['upper'].mass"
    again = eqx.tree_at(lambda m: m.loads["gravity"], RIG, LOAD)
    assert type(again.loads["gravity"]) is jc.load.JointTorque


@pytest.mark.parametrize("mass", [2.0, np.asarray(2.0), np.float32(2.0), 2])
def test_a_changed_number_of_any_kind_is_one_where_parts_are_exchanged(mass):
    heavier = eqx.tree_at(lambda m: m.bodies["fore"].mass, RIG, mass)
    assert float(heavier.with_load("motor", LOAD).bodies["fore"].mass) == 2.0
    wearing = jc.joint.PlainBearing(length=0.02, wear=jc.Wearing(jc.wear.Archard()))
    hardness = lambda m: m.connections["elbow"].joint.wear.law.hardness
    bad = eqx.tree_at(hardness, RIG.with_joint("elbow", wearing), True)
    with pytest.raises(ValueError, match='joint "elbow", wear, law, has hardness = True'):
        bad.with_load("motor", LOAD)


def test_another_body_or_load_gives_another_mechanism():
    loaded = RIG.with_load("motor", LOAD)
    assert list(loaded.loads) == ["gravity", "motor"] and list(RIG.loads) == ["gravity"]
    assert loaded.start_arguments.keys() == RIG.start_arguments.keys() and loaded.start == RIG.start
    heavy = RIG.with_body("fore", BODY)
    assert float(heavy.bodies["fore"].mass) == 3.0 and list(heavy.bodies) == ["upper", "fore"]
    still = jc.Mechanism(RIG.bodies, RIG.connections, stabilisation=None)
    assert still.with_body("fore", BODY).stabilisation is None
    assert list(heavy.couplings) == list(loaded.couplings) == ["tie"]


def test_the_motion_follows_the_parts_that_stand_in_it():
    """A free pendulum of another mass at the tip swings as one that was built so."""
    rod = jc.Mechanism(
        {"rod": jc.Body(1.0, 0.1, (0.5, 0.0))},
        {"pin": jc.Connection(jc.joint.Revolute(), "ground", "rod")},
        {"gravity": jc.load.Gravity((0.0, -9.81))},
    )
    after = jc.simulate(rod.with_body("rod", BODY), 0.1, save=3).coordinate("pin")
    built = jc.Mechanism({"rod": BODY}, rod.connections, rod.loads)
    np.testing.assert_array_equal(after, jc.simulate(built, 0.1, save=3).coordinate("pin"))
