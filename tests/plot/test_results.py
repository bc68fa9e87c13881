"""Every kind of result has its figure and its xarray Dataset, which files keep as it is."""

import functools
import inspect
import json

import jax.numpy as jnp
import matplotlib.figure
import numpy as np
import pytest
import xarray

import jaxclear as jc
from jaxclear import plot
from jaxclear.ground.datasets import Column, dataset
from jaxclear.plot.overview import FIGURES
from tests.plot.identified import identified

# Where a run begins is no result that could be drawn.
NO_RESULTS = {"Capability", "Fit", "Problem", "State"}


def stack(a, b):
    return {"sum": a + b, "product": a * b}


def problem(function=stack):
    sizes = {
        "a": jc.Dimension(2e-3, jc.distribution.Normal(1e-5), unit="m"),
        "b": jc.Dimension(1e-3, jc.distribution.Uniform(2e-5), unit="m"),
    }
    return jc.FunctionProblem(function, sizes, units={"sum": "m", "product": "m2"})


UM = 1e-6


def sized():
    """A design whose limit is known: the two tolerances add up to 50 um."""
    costs = {"a": jc.cost.Reciprocal(1e-4), "b": jc.cost.Reciprocal(2e-4)}
    limit = jc.limit.WorstCase("sum", at_most=3.05e-3)
    return jc.design(problem(), costs, limit, tolerance=dict.fromkeys("ab", (UM, 100 * UM)))


TOO_LONG = jc.limit_state.Above("sum", 3.03e-3)
CHEAPER = problem(lambda a, b: {"sum": a + 0.9 * b, "product": a * b})


def answered():
    limit = jc.limit.Quantile("sum", at_most=3.05e-3, share=0.95)
    return jc.largest(problem(), "a", limit, (1e-3, 3e-3), accuracy=0.1)


# A result of each kind that a function of dimensions gives.
STUDIES = {
    "Identified": lambda folder: identified(problem()),
    "RemainingLife": lambda folder: jc.remaining_life(
        {1e6: identified(problem()), 2e6: identified(problem())}, "a", limit=3e-3
    ),
    "MonteCarlo": lambda folder: jc.monte_carlo(problem(), 128),
    "Campaign": lambda folder: jc.campaign(problem(), 128, folder=folder),
    "Sensitivity": lambda folder: jc.sensitivity(problem(), sample=128, difference_samples=64),
    "WorstCase": lambda folder: jc.worst_case(problem(), samples=16),
    "Sweep": lambda folder: jc.sweep(problem(), {"a": [0.9e-3, 1.1e-3]}),
    "Screening": lambda folder: jc.screening(problem(), 4),
    "SobolIndices": lambda folder: jc.sobol_indices(problem(), 64),
    "ShapleyEffects": lambda folder: jc.shapley_effects(problem(), 64),
    "ResponseSurface": lambda folder: jc.surface(problem()),
    "CorrectedStatistics": lambda folder: jc.corrected_statistics(
        jc.surface(problem()), 8, limits={"long": TOO_LONG}
    ),
    "Reliability": lambda folder: jc.reliability(problem(), TOO_LONG),
    "Design": lambda folder: sized(),
    "Largest": lambda folder: answered(),
    "MultiFidelity": lambda folder: jc.multi_fidelity(problem(), CHEAPER, 256),
}


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Of each kind one, made when it is first asked for."""
    folder = tmp_path_factory.mktemp("kept") / "campaign"
    return functools.cache(lambda kind: STUDIES[kind](folder))


# Kinds that take a run or a life to have: the slow suite.
LONG = {"CorrectedStatistics", "ShapleyEffects", "Reliability", "Design", "MultiFidelity"}
EACH = [pytest.param(kind, marks=[pytest.mark.slow] * (kind in LONG)) for kind in STUDIES]
OF_RUNS = ["Trajectory", "PointingError", "Positions", "SteadyCycle", "WearLife", "WearLifeSample"]
OF_RUNS += ["Advice"]


def kinds():
    """What the public functions return that is defined beside results and studies."""
    found = {}
    for name in jc.__all__:
        given = getattr(jc, name)
        if not inspect.isfunction(given):
            continue
        kind = inspect.signature(inspect.unwrap(given)).return_annotation
        rooms = ("jaxclear.results", "jaxclear.studies")
        if inspect.isclass(kind) and kind.__module__.startswith(rooms):
            found[kind.__name__] = kind
    return {name: kind for name, kind in found.items() if name not in NO_RESULTS}


def test_every_kind_of_result_has_a_figure_and_a_dataset():
    found = kinds()
    assert {"Trajectory", "MonteCarlo", "Sensitivity", "WearLife", "Campaign"} <= set(found)
    for name, kind in found.items():
        assert kind in FIGURES, f"plot.result draws no {name}"
        assert inspect.isfunction(getattr(kind, "to_dataset", None)), f"{name}.to_dataset"
    assert {kind.__name__ for kind in FIGURES} == {*STUDIES, *OF_RUNS}


def check_figure(found):
    figure = plot.result(found)
    assert isinstance(figure, matplotlib.figure.Figure)
    panels = [axis for axis in figure.axes if axis.get_label() != "<colorbar>"]
    assert panels and all(axis.has_data() for axis in panels)
    others = matplotlib.figure.Figure().subplots(1, len(panels), squeeze=False).ravel()
    drawn = plot.result(found, ax=others[0] if len(others) == 1 else others)
    assert list(np.ravel(drawn)) == list(others)
    with pytest.raises(ValueError, match="ax of plot"):
        plot.result(found, ax=matplotlib.figure.Figure().subplots(1, len(panels) + 1))


def check_kept(found, folder):
    """A Dataset is the same after netCDF and Zarr, with units, versions and the problem."""
    how = {"flat": True} if isinstance(found, jc.Trajectory) else {}
    told = found.to_dataset(**how).load()
    assert json.loads(told.attrs["versions"])
    told.to_netcdf(folder / "kept.nc", engine="scipy")
    told.to_zarr(folder / "kept.zarr", consolidated=False)
    by_netcdf = xarray.load_dataset(folder / "kept.nc", engine="scipy")
    by_zarr = xarray.open_zarr(folder / "kept.zarr", consolidated=False).load()
    for kept in (by_netcdf, by_zarr):
        for name, column in told.variables.items():
            own = kept[name]
            if column.dtype.kind in "fiu":
                np.testing.assert_array_equal(own.to_numpy(), column.to_numpy())
            else:
                kept_texts, texts = (np.ravel(one.to_numpy()).tolist() for one in (own, column))
                assert list(map(str, kept_texts)) == list(map(str, texts))
            assert own.attrs.get("units") == column.attrs.get("units")
        assert kept.attrs.get("problem") == told.attrs.get("problem")
        assert json.loads(kept.attrs["versions"]) == json.loads(told.attrs["versions"])


@pytest.mark.parametrize("kind", EACH)
def test_a_result_is_drawn_and_kept_by_files(results, kind, tmp_path):
    found = results(kind)
    assert type(found).__name__ == kind
    check_figure(found)
    check_kept(found, tmp_path)


def test_what_zarr_keeps_is_json_where_numbers_are_not_finite(tmp_path):
    def refused(word):
        raise AssertionError(f"{word} is no JSON")

    column = Column(("row",), np.array([1.0, np.nan, np.inf]), "m")
    told = dataset({"x": column}, what="a test", cost=np.inf, share=np.float64(np.nan), runs=3)
    told.to_zarr(tmp_path / "kept.zarr", consolidated=False)
    texts = [path.read_text() for path in (tmp_path / "kept.zarr").rglob("*.json")]
    assert texts and all(json.loads(text, parse_constant=refused) for text in texts)
    kept = xarray.open_zarr(tmp_path / "kept.zarr", consolidated=False).load()
    np.testing.assert_array_equal(kept["x"], column.values)
    assert (kept.attrs["cost"], kept.attrs["share"], kept.attrs["runs"]) == ("inf", "nan", 3)


def test_a_dataset_holds_the_numbers_with_their_units(results):
    sample, derivatives = results("MonteCarlo"), results("Sensitivity")
    told = sample.to_dataset()
    np.testing.assert_array_equal(told["sum"], sample.responses["sum"])
    np.testing.assert_array_equal(told["a"], sample.values[:, 0])
    assert told["product"].attrs == {"units": "m2", "kind": "response"}
    assert "distribution" in told.attrs["problem"]
    found = derivatives.to_dataset()
    own = derivatives.derivatives["product", "b"]
    picked = found.sel(response="product", variable="b")
    assert float(picked["derivative"]) == own.value and float(picked["error"]) == own.error
    assert str(picked["unit"].item()) == "m2/m"


def test_figures_show_the_closed_form(results):
    """Of a worst case: a from 1.97 to 2.03 mm, b from 0.98 to 1.02 mm; of an error budget of a sum
    variances of 1e-5^2 and (4e-5)^2 / 12."""
    axis = plot.worst_case(results("WorstCase")).axes[0]
    np.testing.assert_allclose(axis.lines[0].get_xdata(), [2.95, 3.05], rtol=1e-6)
    assert axis.get_xlabel() == "sum [mm]"
    figure = plot.error_budget(results("MonteCarlo"), "sum")
    widths = [patch.get_width() for patch in figure.axes[0].patches]
    own = np.array([1.0, 16 / 12])
    np.testing.assert_allclose(widths[:2], 100 * own / own.sum(), atol=4.0)


def test_what_is_no_result_is_refused():
    with pytest.raises(ValueError, match="the result is 3"):
        plot.result(3)
    with pytest.raises(ValueError, match="the study is 3"):
        plot.sobol_indices(3)


@pytest.mark.slow
@pytest.mark.parametrize("kind", OF_RUNS)
def test_a_result_of_runs_is_drawn_and_kept(run, kind, tmp_path):
    period = 2 * np.pi / 50.0
    clearance = lambda rig: rig.connections["B"].joint.clearance
    asked = jc.Problem(
        jc.scenes.slider_crank(wear=True, crank_speed=50.0),
        duration=period,
        variables={"clearance": jc.Variable(clearance, tolerance=20e-6)},
        response={"peak": jc.response.PeakWornDepth("B", "bearing")},
        integrator=jc.integrator.ImplicitStep(),
    )
    found = {
        "Trajectory": lambda: run,
        "PointingError": lambda: jc.pointing_error(run, "slider", through=("A", "B")),
        "Positions": lambda: jc.positions(asked.mechanism, {"O": jnp.linspace(0.1, 1.0, 5)}),
        "SteadyCycle": lambda: jc.steady_cycle(asked, cycles=3),
        "WearLife": lambda: jc.wear_life(asked, cycles=1e3, max_cycles=3),
        "WearLifeSample": lambda: jc.wear_life_sample(asked, 2, cycles=1e3, max_cycles=3),
        "Advice": lambda: jc.advise(asked, 0.05, pilot=jc.PilotSettings(copies=2)),
    }[kind]()
    assert type(found).__name__ == kind
    check_figure(found)
    check_kept(found, tmp_path)


def test_a_run_in_the_plane_shows_signed_rates_and_forces_that_a_peak_does_not_flatten():
    """The rod of a slider-crank swings to and fro; impacts are a hundred times the mean force."""
    run = jc.simulate(jc.scenes.slider_crank(), 0.126, save=201, verify=False)
    _, turns, forces = plot.result(run).axes
    lines = {line.get_label(): line.get_ydata() for line in turns.lines}
    np.testing.assert_allclose(lines["rod"], run.body("rod").spin[:, 2])
    assert lines["rod"].min() < 0 < lines["rod"].max()
    assert turns.get_ylabel()[:16] == "angular velocity"
    saved = np.asarray(run.contact("B").normal_force).max()
    assert forces.get_ylim()[1] == pytest.approx(1.1 * saved, rel=1e-6)
