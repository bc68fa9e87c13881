"""What is shown of an answer: whole in a terminal of 80 columns, in a notebook as HTML, numbers
with their units. Every class of answers is looked at."""

import functools
import math
import pickle
import re

import numpy as np
import pandas
import pytest

import jaxclear as jc
from jaxclear.ground.printing import AbstractShown, with_error
from jaxclear.ground.quantity import AbstractQuantified
from jaxclear.ground.table import MOST_ROWS, as_table
from tests.plot.identified import identified
from tests.test_architecture import own_classes

NAMES = ("a", "width of the gap between the slider and the guide at the far end")
UNITS = {"gap": "m", "force": "N", "share": "1"} | {f"deflection number {i}": "m" for i in range(9)}


def responses(**x):
    a, wide = (x[name] for name in NAMES)
    found = {"gap": 1e-12 * (a - wide), "force": 1e6 * a * wide, "share": 0 * a}
    return found | {f"deflection number {i}": 0.3 + 1e-6 * i * a for i in range(9)}


@functools.cache
def asked():
    """Twelve responses, of 1e-12 m and of 1e6 N, and a long name."""
    normal = jc.distribution.Normal(0.1)
    return jc.FunctionProblem(responses, {n: jc.Dimension(2.0, normal) for n in NAMES}, units=UNITS)


@functools.cache
def few():
    """Two of them, of parts with ends."""
    wanted = {n: u for n, u in UNITS.items() if n in ("gap", "force")}
    own = lambda **x: {n: r for n, r in responses(**x).items() if n in wanted}
    return jc.FunctionProblem(
        own, {n: jc.Dimension(2.0, tolerance=1e-3) for n in NAMES}, units=wanted
    )


@functools.cache
def sample():
    return jc.monte_carlo(asked(), 32)


@functools.cache
def surface():
    return jc.surface(asked())


@functools.cache
def derived():
    return jc.sensitivity(few(), NAMES[0], sample=32, difference_samples=16)


@functools.cache
def reliability():
    return jc.reliability(few(), jc.limit_state.Above("gap", 1.5e-15))


@functools.cache
def worst():
    return jc.worst_case(few(), samples=8)


@functools.cache
def design():
    limit = jc.limit.MeanAndDeviation("gap", at_most=2e-14, deviations=3)
    own = {n: jc.cost.Reciprocal(1e-3) for n in NAMES}
    return jc.design(few(), own, limit, tolerance=dict.fromkeys(NAMES, (1e-4, 1e-1)))


@functools.cache
def rig():
    return jc.scenes.slider_crank()


@functools.cache
def run():
    save = jc.Saving(11, events=4)
    return jc.simulate(rig(), 0.01, save=save, balance=True, verify=True)


def coupled():
    gear = jc.coupling.Gear(jc.coupling.Motor(1e-4), "J", 20.0, stiffness=400.0, damping=2.0)
    joints = {"J": jc.Connection(jc.joint.Revolute(), "ground", "arm")}
    rig = jc.Mechanism({"arm": jc.Body(1.0, 0.1)}, joints, couplings={"gear": gear})
    return jc.simulate(rig, 0.01, save=3).coupling("gear")


def table_of(found):
    return found().table()


def record():
    seen = {"gap": jc.sensor.Displacement("rod")}
    return jc.Measurement([0.0, 0.1, 0.2], {"gap": [0.0, 1e-3, 2e-3]}, seen)


def life():
    told = identified(few())
    return jc.remaining_life({0: told, 1e6: told}, NAMES[0], limit=3.0)


LIMITS = {"gap": (-1e-12, None)}
ANSWERS = {
    "monte carlo": sample,
    "samples": lambda: sample().table(),
    "summary": lambda: sample().summary(LIMITS),
    "mean": lambda: sample().mean("force"),
    "statistics": lambda: [sample().quantile("gap", 0.9), sample().standard_deviation("gap")],
    "budget of errors": lambda: sample().error_budget("gap"),
    "tolerance interval": lambda: [sample().tolerance_interval("force", 0.5)],
    "sensitivity": derived,
    "derivatives": lambda: table_of(derived),
    "derivative": lambda: derived().derivatives["gap", NAMES[0]],
    "estimates": lambda: derived().derivatives["gap", NAMES[0]].estimates,
    "surface": surface,
    "corrected_statistics": lambda: jc.corrected_statistics(surface(), 8),
    "worst case": worst,
    "extreme": lambda: worst().least["force"],
    "sweep": lambda: jc.sweep(few(), {few().names[0]: [1.0, 2.0]}),
    "screening": lambda: jc.screening(few(), 4),
    "sobol indices": lambda: jc.sobol_indices(few(), 32),
    "shapley effects": lambda: jc.shapley_effects(surface(), 64),
    "multi-fidelity": lambda: jc.multi_fidelity(few(), {"other": few()}, costs={"other": 0.1}),
    "reliability": reliability,
    "probabilities": lambda: [table_of(reliability), reliability().design_points()],
    "points": lambda: [*reliability().estimates.values(), *reliability().points],
    "design": design,
    "limits": lambda: design().limit_table(),
    "history": lambda: design().history(),
    "record": record,
    "identified": lambda: identified(few()),
    "remaining life": life,
    "run": run,
    "errors": lambda: run().verification,
    "checks": lambda: run().invariants,
    "stats": lambda: run().stats,
    "extremes": lambda: run().extremes,
    "estimate": lambda: [run().estimate(jc.response.MeanContactForce("B"))],
    "body": lambda: run().body("rod"),
    "marker": lambda: run().marker("rod", (0.0, 0.0)),
    "contact": lambda: run().contact("B"),
    "forces": lambda: run().contact("B").table(),
    "reaction": lambda: run().reaction("A"),
    "coupling": coupled,
    "energies": lambda: run().energy_balance(),
    "modes": lambda: [run().modes("B"), run().combined_modes(), run().events()],
    "state": lambda: run().state(),
    "mechanism": rig,
    "parameters": lambda: rig().parameters(),
    "start": lambda: [jc.assemble(rig())],
    "assemblies": lambda: jc.assemblies(rig(), 4),
    "positions": lambda: jc.positions(rig(), {"O": [0.1, 0.2]}),
    "poses": lambda: jc.positions(rig(), {"O": [0.1, 0.2]}).body("rod"),
    "complementarity": lambda: jc.complementarity.InteriorPoint().solve(
        jc.complementarity.LCP(np.eye(2), np.array([1.0, -1.0]))
    ),
}
# Probabilities, counts, and what does not know its unit.
WITHOUT = ("stats", "complementarity", "extreme", "points", "estimates", "derivative")
WITHOUT = (*WITHOUT, "reliability")
# Others hold what takes long to find; their words are sentences, their tables those of `as_table`.
SENTENCES = {
    *("Advice", "Failed", "Fmu", "Largest", "PointingError", "SteadyCycle", "Unverified"),
    *("WearLife", "WearLifeSample"),
}


@functools.cache
def answer_of(name):
    return ANSWERS[name]()


def everything(shown):
    """What is shown, of dictionaries and lists what is in them."""
    if isinstance(shown, dict):
        return list(shown.values())
    return shown if isinstance(shown, list) else [shown]


@pytest.mark.parametrize("name", ANSWERS)
def test_an_answer_prints_numbers_with_units(name):
    answer = answer_of(name)
    text = str(answer)
    assert not re.search(r"np\.float|array\(|f64\[|[^\w]-0\.0*\b(?!\d)", text), text
    assert name in WITHOUT or re.search(r"\[\(?(m|N|1|J|rad|kg)|\b(m|N|s|rad)\b", text), text
    for part in everything(answer):
        html = part._repr_html_()
        assert html.startswith("<") and len(html) < 40_000
        for table in tables(part):
            assert max(map(len, repr(table).splitlines())) <= 80, repr(table)
            assert "…" not in repr(table)


def tables(part):
    if isinstance(part, pandas.DataFrame):
        return [part]
    own = part._parts() if isinstance(part, AbstractShown) else ()
    return [one for one in own if isinstance(one, pandas.DataFrame)]


def test_every_class_of_answers_is_looked_at():
    kinds = [k for k in own_classes().values() if issubclass(k, AbstractShown)]
    answers = {
        kind.__name__
        for kind in kinds
        if not issubclass(kind, AbstractQuantified) and not kind.__name__.startswith("Abstract")
    }
    seen = {type(part).__name__ for name in ANSWERS for part in everything(answer_of(name))}
    assert answers - seen == SENTENCES


EXTREME = {
    "a response with a long name that somebody thought of late": [1e-12, -0.0, -3e-12],
    "force": [1e6, math.inf, math.nan],
    "place": [1.000001, 1.0, 1.000003],
    "result": ["The run reached its end, at last."] * 3,
    "warnings": ["", "Peak forces are not resolved by the steps of this run.", ""],
}


def test_a_table_is_read_by_its_four_digits_and_its_numbers_stay():
    found = as_table(EXTREME, units={"force": "N", "place": "m"})
    text = repr(found)
    assert "1e+06" in text and "inf" in text and "–" in text and "-0" not in text
    assert "force [N]" in text and "1.000003" in text and "-3e-12" in text
    assert "result: The run reached its end, at last." in text
    plain = pandas.DataFrame(EXTREME)
    pandas.testing.assert_frame_equal(pandas.DataFrame(found), plain)
    pandas.testing.assert_frame_equal(pickle.loads(pickle.dumps(found)), plain)
    some = found[found["force"] > 1].sort_values("place", ascending=False)[["force", "place"]]
    assert list(some["force"]) == [1e6, math.inf] and "force [N]" in repr(some)
    assert "force [N]" in pandas.concat([found, found], ignore_index=True)._repr_html_()


def test_rows_of_one_unit_stand_as_columns_where_they_fit_so():
    row = {"unit": "m", "mean": 1.0, "mean error": 2e-6, "least": 0.999975, "largest": 1.000025}
    many = {f"quantile {i}": 1.0 + 1e-6 * i for i in range(9)}
    found = as_table([{"response": f"gap {i}"} | row | many for i in range(2)])
    lines = repr(found).splitlines()
    assert lines[0].split() == ["response", "gap", "0", "[m]", "gap", "1", "[m]"]
    assert lines[1].split()[1:] == ["1.0000000", "±", "0.0000020"] * 2
    assert "0.999975" in lines[2] and "1.000025" in lines[3]


def test_a_head_breaks_between_words_not_within_a_number():
    wide = {f"force at 99.7 % [N] {i}": [1.23456e-5] for i in range(3)}
    lines = repr(as_table(wide)).splitlines()
    assert max(map(len, lines)) <= 80 and any("99.7" in line for line in lines)
    assert not any(word.endswith("99.") for line in lines for word in line.split())


def test_of_a_long_table_the_ends_are_shown():
    long = as_table({"time [s]": np.linspace(0.0, 1.0, MOST_ROWS + 1)})
    assert len(repr(long).splitlines()) < 30 and f"of {MOST_ROWS + 1} rows" in repr(long)
    assert len(repr(as_table(columns=["time [s]", "mode"])).splitlines()) == 1


@pytest.mark.parametrize(
    ("value", "error", "words"),
    [
        (1.2346e-12, 2e-14, "(1.235 ± 0.020)e-12"),
        (1234567.0, 890.0, "(1.23457 ± 0.00089)e+06"),
        (-0.001, 3.4, "0.0 ± 3.4"),
        (302595.0, 82094.0, "303000 ± 82000"),
        (0.3, 0.0, "0.3 ± 0"),
        (0.3, math.inf, "0.3 ± –"),
        (math.inf, math.inf, "inf"),
        (1.0, 1e-9, "1 ± 1e-09"),
        (math.nan, math.nan, "– ± –"),
    ],
)
def test_a_number_beside_its_error(value, error, words):
    assert with_error(value, error) == words


def test_nothing_stands_in_the_way_of_printing():
    """What is shown goes through `_parts` without arguments: no class gives the name to another."""
    kinds = [kind for kind in own_classes().values() if issubclass(kind, AbstractShown)]
    assert len(kinds) > 10
    assert all(kind._parts is AbstractShown._parts for kind in kinds)
