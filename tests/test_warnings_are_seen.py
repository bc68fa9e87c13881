"""What a run warns of stands where its numbers are read: in figures, in print, in saved data."""

import dataclasses

import jax.numpy as jnp
import pytest

import jaxclear as jc
from jaxclear import plot
from jaxclear.commands.study import report_warnings
from jaxclear.integrators.checks import Check, Checks, Figure
from jaxclear.plot.canvas import as_warnings, canvas, captioned
from jaxclear.results.pointing_error import pointing_error


@pytest.fixture(scope="module")
def clean():
    rig = jc.scenes.slider_crank()
    return jc.simulate(rig, 2e-4, save=3, integrator=jc.integrator.FixedStep(2e-5))


def warning(run):
    """The run, whose contact sinks in too far."""
    found = Figure(jnp.array([7.3]), jnp.array([1e-4]), ("B",))
    return dataclasses.replace(run, invariants=Checks.of({Check.INDENTATION: found}))


def texts(figure):
    return " ".join(" ".join(text.get_text() for text in figure.texts).split())


FIGURES = {
    "displacement": lambda run: plot.displacement({"own": run}, run, "slider"),
    "angular velocity": lambda run: plot.angular_velocity(run, run, "rod"),
    "pointing": lambda run: plot.pointing_budget(pointing_error(run, "slider", through=("A", "B"))),
}


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_of_a_run_with_warnings_says_so(clean, name):
    run = warning(clean)
    assert texts(FIGURES[name](clean)).count("Warning") == 0
    figure = FIGURES[name](run)
    assert run.warnings[0][:30] in texts(figure)


def test_warnings_below_a_figure_are_red_and_notes_are_not():
    """Figures of right runs had red sentences below them."""
    colours = []
    for sentences in (["64 samples are too few for an interval."], as_warnings(["It sank in."])):
        figure, axes = canvas(1, 1)
        axes.plot([0, 1])
        captioned(figure, sentences)
        colours.append(figure.texts[-1].get_color())
    assert colours == ["0.35", "C3"]


def test_a_caption_ends_with_how_many_more_there_are_and_hides_nothing():
    figure, axes = canvas(2, 1, sharex=True)
    axes[0].plot([0, 1], label="line")
    axes[1].set_xlabel("time [s]")
    figure.legend(loc="outside lower center")
    height = figure.get_figheight()
    captioned(figure, [f"Sentence {i}, " + "which is rather long, " * 9 for i in range(5)])
    figure.draw_without_rendering()
    caption, legend = figure.texts[-1].get_window_extent(), figure.legends[0].get_window_extent()
    assert caption.y0 > 0 and caption.x1 < figure.bbox.width
    assert caption.y1 <= legend.y0 and legend.y1 <= axes[1].get_tightbbox().y0
    assert figure.get_figheight() > height
    said = figure.texts[-1].get_text()
    assert said.startswith("Sentence 0, which") and said.endswith("(+2 more)")
    assert said.count("\n") == 5


def test_the_command_line_tells_warnings(clean, capsys):
    report_warnings({"clean": clean, "clearance 0.2 mm": warning(clean)})
    said = capsys.readouterr().out.splitlines()
    assert len(said) == 1 and said[0].startswith("warning, clearance 0.2 mm: The indentation")


def test_saved_data_carries_the_warnings_and_figures(clean):
    attributes = warning(clean).to_dataset().attrs
    assert attributes["warnings"] == warning(clean).warnings[0]
    assert attributes["check_indentation"] == f"7.3 (limit {Check.INDENTATION.limit:g}), joint B"


def test_a_pointing_error_tells_what_its_run_warns_of(clean):
    error = pointing_error(warning(clean), "slider", through=("A", "B"))
    assert error.warnings == warning(clean).warnings and error.sentence().endswith(
        error.warnings[0]
    )
