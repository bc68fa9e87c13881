"""Tolerances as drawings state them: ISO 286 against its tables, fits, zones and material
conditions against closed forms and enumeration."""

import csv
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

import jaxclear as jc
from jaxclear.studies.experiment import Setting
from jaxclear.studies.tolerance import iso286
from tests.rigs.refusals import refusals

T, D, UM = jc.tolerance, jc.distribution, 1e-6
REFDATA = Path(__file__).parents[1] / "refdata"
RIG = jc.scenes.slider_crank()


def rows(name):
    """A table of shared facts, whose sources the package's own tables name."""
    lines = (REFDATA / name).read_text(encoding="utf-8").splitlines()
    return list(csv.DictReader(line for line in lines if not line.startswith("#")))


def test_all_limits_of_iso_286_are_those_of_the_printed_tables():
    table = rows("iso286_limits.csv")
    for row in table:
        exact = float(row["lower_um"]), float(row["upper_um"])
        assert iso286.limits(float(row["size_mm"]), row["class"]) == exact, row
    assert len(table) == 1643


def test_fits_have_their_limits_and_clearances():
    table = rows("iso286_fits.csv")
    for row in table:
        name, *exact = row.values()
        own = jc.fit(name)
        # Digit by digit: no minus before a zero.
        found = [*own.hole_limits, *own.shaft_limits, *own.clearance]
        assert str(found) == str([float(f"{each}e-6") for each in exact])
    assert len(table) == 15
    assert jc.fit("8 JS2/js2").hole_limits == (-0.75e-6, 0.75e-6)
    fit = jc.fit("20 H7/g6")
    for text in ("20H7/g6", "ø20 H7/g6", "⌀20H7 / g6", "20.0 H7/g6"):
        assert (jc.fit(text).size, jc.fit(text).clearance) == (0.02, fit.clearance)
    # 20 H7/g6 of ISO 286: hole 0 to +21, shaft -20 to -7 um.
    assert "hole +0 to +21 um, shaft -20 to -7 um" in str(fit) and "7 to 41 um" in str(fit)


@pytest.mark.parametrize(
    ("how", "mean", "deviation"),
    [
        (jc.process(distribution="uniform"), 24.0, np.hypot(21, 13) / 12**0.5),
        (jc.process(1.33), 24.0, np.hypot(21, 13) / (6 * 1.33)),
        (jc.process(1.33, cpk=1.0), 24 - 34 / 2.66 * 0.33, np.hypot(21, 13) / (6 * 1.33)),
    ],
)
def test_clearance_of_a_fit_is_the_closed_form(how, mean, deviation):
    """7.1298 and 3.0950 um; Cpk 1.0 moves both means to most material: 19.782 um."""
    own = jc.Drawing(RIG, {"B": jc.fit("20 H7/g6", hole=how, shaft=how)})
    joint = own.mechanism.connections["B"].joint
    assert 2 * float(joint.clearance) == pytest.approx(UM * mean, rel=1e-9)
    spread = [float(law.deviation()) for law in own.variables["B"].distribution.marginals()]
    assert np.hypot(*spread) == pytest.approx(UM * deviation, rel=1e-9)
    low, high = own.table()["lower"], own.table()["upper"]
    if how.distribution == "uniform":
        np.testing.assert_allclose(1e3 * low, [20.0, 19.98], atol=1e-12)
        np.testing.assert_allclose(1e3 * high, [20.021, 19.993], atol=1e-12)


def parts(drawing, count, read, seed=0):
    """What `read` says of many parts of a drawing, by random numbers of its own."""
    names = drawing.names
    own = tuple(drawing.variables[name] for name in names)
    sizes = [max(len(one.parts), 1) for one in own]
    scores = jnp.asarray(np.random.default_rng(seed).normal(size=(count, sum(sizes))))
    values, first = [], 0
    for one, size in zip(own, sizes, strict=True):
        law, some = one.distribution, scores[:, first : first + size]
        away = law.of_scores(some) if one.parts else law.of_score(some)
        values.append(one.nominal_in(drawing.mechanism) + away)
        first += size

    @eqx.filter_jit
    def each(mechanism, values):
        return jax.vmap(lambda row: read(Setting(names, own, row)(mechanism)))(values)

    return each(drawing.mechanism, jnp.concatenate(values, axis=1))


def test_a_zone_at_most_material_has_the_bonus_of_the_size_of_each_part():
    """r in a disc of diameter t + b, b even in [0, B]: beyond t/2 lies B / (t + B) of the parts,
    and no part breaks the virtual condition, hole less twice the shift (ISO 2692)."""
    t, B = 20e-6, 21e-6
    lines = {
        "B": jc.fit("20 H7/g6", hole=jc.process(distribution="uniform")),
        "bore": T.Position(t, marker="B.parent", at_mmc="B"),
    }

    def read(m):
        x, y = m.connections["B"].parent.at
        return jnp.hypot(x - 0.12, y), m.connections["B"].joint.diameters()[0]

    shift, hole = parts(jc.Drawing(RIG, lines), 100_000, read)
    beyond = float(np.mean(shift > t / 2))
    assert beyond == pytest.approx(B / (t + B), abs=3 * 0.5 / 100_000**0.5)
    assert np.all(hole - 2 * shift >= 20e-3 - t - 1e-15)
    least = lines | {"bore": T.Position(t, marker="B.parent", at_lmc="B hole")}
    shift, hole = parts(jc.Drawing(RIG, least), 10_000, read)
    assert np.all(shift <= 0.5 * (t + 20.021e-3 - hole) + 1e-15)


@pytest.mark.slow
def test_the_worst_slide_over_two_zones_is_slsqps():
    """Closed geometry of a slider-crank with its pin and bore anywhere in their discs."""
    ideal, angle, crank, rod = jc.scenes.slider_crank("ideal"), 0.7, 0.05, 0.12
    lines = {
        "pin": T.Position(30e-6, marker="A.parent"),
        "bore": T.Position(20e-6, marker="B.parent"),
    }
    own = jc.Drawing(ideal, lines)
    slide = {"slide": jc.response.FromFunction(lambda s: s.body("slider").com[0, 0], "m")}
    asked = jc.PositionProblem(own.mechanism, slide, own.variables, positions={"O": [angle]})
    found = jc.worst_case(asked, samples=32)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def exact(v):
        pin, length = turn @ (np.array([crank, 0]) + v[:2]), np.hypot(rod + v[2], v[3])
        return pin[0] + np.sqrt(max(length**2 - pin[1] ** 2, 0.0))

    inside = [
        {"type": "ineq", "fun": lambda v, i=i, r=r: r**2 - v[i] ** 2 - v[i + 1] ** 2}
        for i, r in ((0, 15.0), (2, 10.0))
    ]
    for end, sign in ((found.largest, -1), (found.least, 1)):
        of = lambda v, sign=sign: sign * 1e6 * (exact(1e-6 * v) - exact(np.zeros(4)))
        ends = [
            scipy.optimize.minimize(of, v, method="SLSQP", constraints=inside, tol=1e-13).fun
            for v in np.random.default_rng(0).normal(size=(6, 4))
        ]
        limit = exact(np.zeros(4)) + 1e-6 * sign * min(ends)
        assert end["slide"].value == pytest.approx(limit, abs=1e-9)


@pytest.mark.slow
def test_two_pins_go_into_two_holes_as_often_as_quadrature_says():
    """To first order where the distances of the centres differ by half of both clearances."""
    radius, half = 25.0, np.array([22.0, 15.0])
    disc, even = D.Ball(radius), [D.Uniform(0.5 * own) for own in half]
    names = ("hole 1", "hole 2", "pin 1", "pin 2")
    variables = {name.replace(" ", "_"): jc.Dimension((0.0, 0.0), disc) for name in names}
    variables |= {
        f"size_{i}": jc.Dimension(mean, even[i // 2])
        for i, mean in enumerate((11.0, 11.0, -20.5, -20.5))
    }

    def room(hole_1, hole_2, pin_1, pin_2, size_0, size_1, size_2, size_3):
        apart = lambda a, b: jnp.hypot(60e3 + b[0] - a[0], b[1] - a[1])
        clearance = 0.5 * (size_0 + size_1 - size_2 - size_3)
        return clearance - jnp.abs(apart(hole_1, hole_2) - apart(pin_1, pin_2))

    study = jc.monte_carlo(jc.FunctionProblem(room, variables), 16384)
    x = np.linspace(-radius, radius, 4001)
    one, dx = 2 / (np.pi * radius**2) * np.sqrt(radius**2 - x**2), x[1] - x[0]
    four = one
    for _ in range(3):
        four = np.convolve(four, one) * dx
    grid, shares = np.arange(len(four)) * dx - 4 * radius, np.cumsum(four) * dx
    hole, pin = np.ones(2201), np.ones(1501)
    gaps = np.convolve(np.convolve(hole, hole), np.convolve(pin, pin))
    at = 0.5 * (2 * 13.0 + 0.01 * np.arange(len(gaps)))
    exact = gaps @ (np.interp(at, grid, shares) - np.interp(-at, grid, shares)) / gaps.sum()
    assert exact == pytest.approx(0.775, abs=1e-3)
    found = study.share_within({"response": (0.0, None)})
    assert abs(found.value - exact) < found.error < 0.005


def test_a_warm_fit_is_the_closed_form():
    own = jc.Drawing(RIG, {"B": "20 H7/g6"})
    warm = jc.apply_thermal_expansion(own.mechanism, 40.0, {"rod": 23e-6, "slider": 11.5e-6})
    hole, shaft = 20e-3 + 10.5 * UM, 20e-3 - 13.5 * UM
    exact = hole * (1 + 23e-6 * 40) - shaft * (1 + 11.5e-6 * 40)
    assert exact == pytest.approx(33.21587 * UM, abs=5e-12)
    assert 2 * float(warm.connections["B"].joint.clearance) == pytest.approx(exact, rel=1e-12)


def test_an_overrunning_clutch_has_its_printed_angle():
    """Fortini 1967, Dimensioning for Interchangeable Manufacture: 7.01839 degrees."""
    of = lambda hub, roller, cage: jnp.arccos((hub + roller) / (cage - roller))
    sizes = {"hub": (27.645, 0.05), "roller": (11.43, 0.01), "cage": (50.8, 0.0125)}
    own = {name: jc.Dimension(a, D.Normal(b / 3), unit="mm") for name, (a, b) in sizes.items()}
    clutch = jc.FunctionProblem(of, own, units="rad")
    angle = clutch.evaluate(clutch.nominal()).responses["response"]
    assert np.rad2deg(angle) == pytest.approx(7.01839, abs=5e-6)


def spatial():
    """Two bodies in space, a bore along x."""
    body = lambda: jc.Body(mass=1.0, inertia=(1e-3, 1e-3, 1e-3))
    joints = {
        "foot": jc.Connection(jc.joint.Revolute(), "ground", "arm"),
        "bore": jc.Connection(
            jc.joint.Revolute(), jc.Marker("arm", (0.1, 0.0, 0.0), "x"), jc.Marker("tip", axis="x")
        ),
    }
    return jc.Mechanism({"arm": body(), "tip": body()}, joints)


def test_place_and_lean_of_a_bore_share_its_cylinder():
    """In space both ends of the axis stay within the cylinder, across the axis that it has."""
    size, length = 0.05e-3, 0.04
    own = jc.Drawing(spatial(), {"bore": T.Position(size, marker="bore.parent", length=length)})
    assert own.variables["bore"].parts == ("near x", "near y", "far x", "far y")

    def read(m):
        marker = m.connections["bore"].parent
        pose, centre = marker.pose(), marker.at
        axis = [row[2] for row in pose.rotation]
        ends = [
            [o + s * 0.5 * length * a for o, a in zip(centre, axis, strict=True)] for s in (-1, 1)
        ]
        return jnp.stack([jnp.stack(list(map(jnp.asarray, end))) for end in ends])

    ends = np.asarray(parts(own, 5000, read))
    np.testing.assert_allclose(ends[:, :, 0], [[0.08, 0.12]] * 5000, atol=1e-8)
    across = np.linalg.norm(ends[:, :, 1:], axis=2)
    assert across.max() <= 0.5 * size * (1 + 1e-6)
    # Each end fills its disc evenly: the square of the distance is uniform.
    assert np.mean((2 * across / size) ** 2) == pytest.approx(0.5, abs=0.02)
    assert np.corrcoef(ends[:, 0, 1], ends[:, 1, 1])[0, 1] == pytest.approx(0, abs=0.05)


def test_a_zone_of_two_widths_has_a_row_for_each_and_a_cylinder_its_whole_law():
    lines = {
        "pin": T.Position(width=(10e-6, 20e-6), marker="bore.parent"),
        "bore": T.Position(50e-6, marker="bore.child", length=0.04),
    }
    table = jc.Drawing(spatial(), lines).table()
    np.testing.assert_allclose(table["upper"], [5e-6, 10e-6, 25e-6])
    assert "near x" in table["distribution"][2]


def test_a_direction_leans_by_the_width_over_the_length():
    own = jc.Drawing(spatial(), {"axis": T.Perpendicularity(20e-6, marker="bore.parent", over=0.1)})
    axis = lambda m: jnp.stack(
        [jnp.asarray(r[2]) for r in m.connections["bore"].parent.pose().rotation]
    )
    lean = np.linalg.norm(np.asarray(parts(own, 2000, axis))[:, 1:], axis=1)
    assert 0.99 * 2e-4 < lean.max() <= 2e-4 * (1 + 1e-6)
    plane = jc.Drawing(RIG, {"guide": T.Angularity(20e-6, marker="G.parent", over=0.1)})
    turn = parts(plane, 1000, lambda m: m.connections["G"].parent.angle)
    assert 0.99 * 2e-4 < np.abs(turn).max() <= 2e-4


def test_zones_to_one_datum_share_its_shift():
    """Both bores of a coupler, the second measured from the first."""
    bar = jc.scenes.four_bar("ideal", friction=False, wear=False)
    lines = {
        "second": T.Position(10e-6, marker="B.parent", datum="first"),
        "first": T.Position(40e-6, marker="A.child"),
    }
    read = lambda m: jnp.stack([*m.connections["A"].child.at, *m.connections["B"].parent.at])
    first_x, first_y, x, y = np.asarray(parts(jc.Drawing(bar, lines), 4000, read)).T
    assert np.hypot(x - 0.4 - first_x, y - first_y).max() <= 5e-6 * (1 + 1e-9)
    assert np.hypot(x - 0.4, y).max() > 20e-6
    with pytest.raises(ValueError, match="go round in a circle"):
        jc.Drawing(bar, lines | {"first": T.Position(40e-6, marker="A.child", datum="second")})


def test_lengths_without_a_tolerance_take_the_general_one():
    """ISO 2768-m: +-0.3 mm from 30 to 120 mm."""
    own = {"rod": T.Size(lambda m: m.connections["B"].parent.at[0])}
    row = jc.Drawing(RIG, own, general="ISO 2768-m").table().iloc[0]
    np.testing.assert_allclose([row["lower"], row["upper"]], [0.1197, 0.1203], rtol=1e-12)
    assert row["specification"] == "120 ±0.3 ISO 2768-m"
    band = {"rod": T.Size(own["rod"].where, 5e-5, jc.process(distribution="uniform"))}
    row = jc.Drawing(RIG, band).table().iloc[0]
    np.testing.assert_allclose([row["lower"], row["upper"]], [0.11995, 0.12005], rtol=1e-12)


ROD = lambda m: m.connections["B"].parent.at[0]


def drawing(name, line, **how):
    """A drawing of the slider-crank with this line."""
    return jc.Drawing(RIG, {name: line}, **how)


test_what_a_drawing_cannot_say_gets_a_sentence = refusals(
    {
        "v5x. is no fit": lambda: jc.fit("20 H7/v5x"),
        "must be a class of ISO 2768-1": lambda: drawing("B", "20 H7/g6", general="ISO 2768-q"),
        "2.0.5 .*is no fit": lambda: jc.fit("2.0.5 H7/g6"),
        "no class v6 at 12 mm": lambda: jc.fit("12 H7/v6"),
        "up to 500 mm": lambda: jc.fit("800 H7/g6"),
        "no grade 19": lambda: jc.fit("20 H19/g6"),
        "press fit: .* interference of up to 35": lambda: drawing("B", "20 H7/p6"),
        "transition fit: .* -15 to 19 um": lambda: drawing("B", "20 H7/k6"),
        "with clearance": lambda: drawing("A", "20 H7/g6"),
        "a.* out of the plane": lambda: drawing(
            "a", T.Position(1e-5, marker="A.parent", spherical=True)
        ),
        "lean.* out of the plane": lambda: drawing(
            "lean", T.Parallelism(1e-5, marker="A.parent", over=0.1)
        ),
        "no chain of dimensions": lambda: drawing(
            "a", T.Coaxiality(1e-5, marker="A.parent", datum="B.parent")
        ),
        "has a datum": lambda: T.Coaxiality(1e-5, marker="A.parent"),
        "must be a line of this drawing": lambda: drawing(
            "a", T.Position(1e-5, marker="A.parent", datum="rod")
        ),
        "no size on this drawing": lambda: drawing(
            "a", T.Position(1e-5, marker="A.parent", at_mmc="A")
        ),
        'such as "A.parent"': lambda: T.Position(1e-5, marker="A"),
        '"Q"': lambda: drawing("a", T.Position(1e-5, marker="Q.parent")),
        "one of the two": lambda: T.Position(1e-5, marker="A.parent", width=1e-5),
        "it has one of the two": lambda: T.Position(
            1e-5, marker="B.parent", at_mmc="B", at_lmc="B"
        ),
        "one size that grows": lambda: T.Position(
            width=(1e-5, 2e-5), marker="B.parent", at_mmc="B"
        ),
        "has no tolerance": lambda: drawing("rod", T.Size(ROD)),
        "cpk at most cp": lambda: jc.process(1.0, cpk=1.2),
        "leave them out": lambda: jc.process(1.0, distribution="uniform"),
        "no side of most material": lambda: drawing(
            "rod", T.Size(ROD, 1e-5, jc.process(1.3, cpk=1.0))
        ),
        'line "rod" of a Drawing': lambda: drawing("rod", 3.0),
    }
)


def test_a_scene_file_states_its_drawing(tmp_path):
    """Read and written, it gives the problem of the drawing, in motion and at rest."""
    rig = jc.scenes.slider_crank()
    lines = {
        "B": jc.fit("20 H7/g6", shaft=jc.process(1.33, cpk=1.0)),
        "pin": T.Position(30e-6, marker="A.parent"),
        "guide": T.Angularity(20e-6, marker="G.parent", over=0.1),
    }
    error = {"error": jc.response.LargestError(body="slider")}
    scene = jc.Scene(rig, duration=0.02, save=5, responses=error, drawing=lines)
    jc.write_scene(scene, tmp_path / "scene.yaml")
    text = (tmp_path / "scene.yaml").read_text(encoding="utf-8")
    assert "pin: {kind: Position, diameter: 3.0e-05, marker: A.parent" in text
    again = jc.read_scene(tmp_path / "scene.yaml")
    assert again.drawn().table().equals(scene.drawn().table())
    short = text[: text.index("drawing:")] + "drawing: {B: 20 H7/g6}\ngeneral: ISO 2768-m\n"
    (tmp_path / "short.yaml").write_text(short, encoding="utf-8")
    assert jc.read_scene(tmp_path / "short.yaml").drawn().names == ("B",)
    asked = again.at_rest(3).problem()
    assert list(asked.groups) == ["B", "pin", "guide"]
    found = asked.evaluate(asked.nominal()).responses["error"]
    # At mean sizes the slider is off by what the journal is, half the clearance at most.
    assert 0 < found < 0.5 * 24e-6
    with pytest.raises(ValueError, match="nothing drives"):
        jc.Scene(spatial(), duration=0.02, drawing={}).at_rest()
