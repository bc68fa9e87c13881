"""What `print` and a notebook show of an answer: sentences and numbers, not the arrays it is made
of."""

import jax
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.studies.answer import Column, Stated, dataset_of, table_of, with_interval
from jaxclear.studies.design.largest import Trial
from jaxclear.studies.identification.result import Unknown
from jaxclear.studies.life.result import _percent
from jaxclear.studies.statistics.scrambled import Statistic
from jaxclear.studies.statistics.summary import coverage_of_deviation

ASKED = jc.FunctionProblem(
    lambda a, b: {"fit": a - b, "area": a * b},
    {n: jc.Dimension(2.0, jc.distribution.Normal(0.1)) for n in "ab"},
    units={"fit": "mm", "area": "mm2"},
)


class Printer:
    """What IPython hands to an object that shows itself."""

    def text(self, shown):
        self.shown = shown


ANSWERS = {
    "monte_carlo": (
        lambda: jc.monte_carlo(ASKED, 64),
        ("64 samples, 0 failed", "area [mm2]", "4.011 ± 0.031", "95 %"),
    ),
    "sensitivity": (
        lambda: jc.sensitivity(ASKED, sample=64, difference_samples=32),
        ("d(area)/d(b) = ", " ± ", "mm2/m", "From "),
    ),
    "surface": (lambda: jc.surface(ASKED), ("Surface of 2 variables", "leave-one-out R2", "mm2")),
    "worst_case": (lambda: jc.worst_case(ASKED), ("first order", "largest", "mm2", "-0.6")),
    "sobol_indices": (lambda: jc.sobol_indices(ASKED, 64), ("first order", "fit", "total [1]")),
    "shapley_effects": (lambda: jc.shapley_effects(ASKED, 64), ("effect [1]", " ± ", "area")),
    "reliability": (
        lambda: jc.reliability(ASKED, jc.limit_state.Above("fit", 0.3)),
        ("P(", "runs in all"),
    ),
}


def test_micrometres_beside_a_metre_are_seen():
    """`print` told a mean of 1 m as "1 (1 to 1)", and a limit of 1.00002 m as 1."""
    arm = jc.FunctionProblem(
        lambda a, b: a + b,
        {"a": jc.Dimension(0.7, tolerance=20e-6), "b": jc.Dimension(0.3, tolerance=5e-6)},
    )
    study = jc.monte_carlo(arm, 256)
    one = study.quantile("response", 0.95)
    value, _, error, unit = str(one).split()
    assert unit == "m" and repr([one]) == f"[{one}]"
    assert np.allclose([float(value), float(error)], [one.value, one.error], 0, 0.1 * one.error)
    assert f"{1 + 1.645 * 6.72e-6:.5f}" in str(study).splitlines()[-1].split()[-1]
    above = jc.limit.Probability("response", above=1.00002, at_most=1e-2)
    assert above.words() == "share of response above 1.00002"
    assert jc.limit_state.Above("response", 1.0000203).words() == "response above 1.0000203"
    assert "1.000025" in str(jc.worst_case(arm))


@pytest.mark.parametrize("name", ANSWERS)
def test_an_answer_is_shown_in_words(name):
    """`print` gave hundreds of lines of arrays."""
    ask, words = ANSWERS[name]
    answer, printer = ask(), Printer()
    shown = str(answer)
    assert all(word in shown for word in words), shown
    assert "f64[" not in shown and len(shown.splitlines()) < 12
    answer._repr_pretty_(printer, False)
    assert printer.shown == shown


def test_failed_samples_are_told_with_every_answer():
    numbers = {n: jc.Dimension(1.0, jc.distribution.Normal(0.5), unit="1") for n in "ab"}
    root = jc.FunctionProblem(lambda a, b: jax.numpy.sqrt(a) + b, numbers)
    study = jc.monte_carlo(root, 256)
    failed = len(study.failed)
    told = str(jc.sensitivity(root, "a", sample=study, difference_samples=32))
    assert failed > 0 and f"{failed} of 256 samples failed and are left out: that a var" in told
    for answer in (jc.sobol_indices(root, 64), jc.shapley_effects(root, 64)):
        first = str(answer).splitlines()[0]
        assert f"{answer.failed} " in first and "failed and are left out." in first


def test_a_tolerance_interval_is_a_sentence():
    found = jc.monte_carlo(ASKED, 1024).tolerance_interval("fit", 0.9, 0.95, side="upper")
    words = f"90 % of all parts are below {found.high}, with a confidence of 95 %"
    assert str(found) == words


NORMALS = {name: jc.Dimension(0.0, jc.distribution.Normal(1.0), unit="1") for name in "ab"}


def test_what_few_samples_do_not_tell_is_said():
    """Of a lognormal's deviation 81 to 89 of 100 intervals hold, of a normal one's 95."""
    both = jc.FunctionProblem(
        lambda a, b: {"plain": a - b, "heavy": jax.numpy.exp(1.4 * a)}, NORMALS
    )
    few, many = str(jc.monte_carlo(both, 64)), str(jc.monte_carlo(both, 512))
    short = "64 samples are too few for an interval of the 5 % and 95 % quantiles of "
    assert f'{short}"plain", "heavy"' in few
    assert "inf" not in few + str(jc.monte_carlo(both, 64).summary()) and "too few" not in many
    for told in (few, many):
        assert '"heavy" has heavy tails (kurtosis ' in told and "samples are needed" in told
        assert 'deviation of "plain"' not in told


def test_intervals_of_deviations_cover_what_is_said_of_them():
    """By Hall's expansion, beside Student's intervals of 2 000 samples of exponential numbers."""
    rng, held, told = np.random.default_rng(0), [], []
    for sample in rng.exponential(size=(2000, 100)):
        squares = (sample - sample.mean()) ** 2
        half = 1.984 * squares.std(ddof=1) / np.sqrt(len(squares))
        held.append(abs(squares.mean() - 1.0) <= half)
        told.append(coverage_of_deviation(sample))
    assert abs(np.mean(held) - np.mean(told)) < 0.1 and np.mean(told) < 0.92


def test_a_level_that_no_run_has_leaves_its_indices_open():
    """A rare level, and so the index of its variable, was told to be 0 ± 0."""
    rare = jc.distribution.Discrete((0.0, 1.0), (1 - 1e-6, 1e-6))
    numbers = NORMALS | {"b": jc.Dimension(0.0, rare, unit="1")}
    steps = jc.FunctionProblem(lambda a, b: a + 1e4 * b, numbers)
    sobol, shapley = jc.sobol_indices(steps, 64), jc.shapley_effects(steps, 64)
    for study, found in ((sobol, sobol.total), (shapley, shapley.effects)):
        assert (found["response", "b"].low, found["response", "b"].high) == (0.0, 1.0)
        assert 'No run has "b" = 1' in str(study) and "3e+06 samples" in str(study)


def test_columns_are_stated_once():
    """Rows are labelled by what a column maps from, and gaps are nan, or "" among texts."""
    over = ("response", "variable")
    columns = with_interval("share", over, {("f", "a"): Statistic(0.5, 0.4, 0.7)})
    columns |= {"why": Column(over, {("f", "b"): "none"}), "run": Column(("point",), [1.0], "s")}
    table = table_of(Stated("a study", columns))
    assert table.index.tolist() == [("f", "a"), ("f", "b")]
    assert list(table.columns) == ["share", "share error", "why"]
    data = dataset_of(Stated("a study", columns), runs=3)
    assert dict(data.sizes) == {"response": 1, "variable": 2, "point": 1} and data.runs == 3
    assert data["share high"].values.tolist()[0][0] == 0.7 and np.isnan(data["share"][0, 1])
    assert data["why"].values.tolist() == [["", "none"]] and data["run"].units == "s"


def test_a_sentence_of_a_study_states_its_numbers_with_errors_and_unit():
    """A product of two sizes of 2 and 0.1: mean 4, deviation 0.283."""
    study = jc.monte_carlo(ASKED, 64)
    fit, area, *others = study.sentence().split(" (95 %). ")
    middle, spread = area.removeprefix('"area": mean ').split(" mm2, standard deviation ")
    for text, value in ((middle, 4.0), (spread.removesuffix(" mm2"), 0.283)):
        number, error = map(float, text.split(" ± "))
        assert 0 < error < 0.2 and abs(number - value) < 2 * error
    assert fit.startswith('"fit": mean ') and others == ["64 samples, 0 failed, 0 with warnings."]
    assert "95 %" not in study.count_sentence()


def test_a_share_near_its_end_shows_an_interval_within_it():
    """0.988 ± 0.022 would reach beyond 1."""
    assert str(Statistic(0.98828, 0.96613, 0.99757)) == "0.988 (95 %: 0.966 to 0.998)"
    assert str(Statistic(1.0, 0.9857, 1.0)) == "1 (95 %: 0.986 to 1)"
    assert str(Statistic(0.5, 0.4, 0.6)) == "0.50 ± 0.10"


def test_entries_of_answers_show_words_and_few_digits():
    numbers = (0.00015313113, 0.0001423208, 0.00015999988, 4.3e-05, 0.000157, 0.155)
    unknown = Unknown("clearance", "m", *numbers, "identified", "a_x: band energies")
    words = "clearance is 0.0001531 m, 0.0001423 to 0.00016 m with 95 %."
    assert str(unknown) == repr(unknown) == words
    trial = Trial(0.00017214040056201326, 0.0001997758264718308, 2.1e-07, -1.4e-08, 0.0, ())
    assert repr(trial) == "at 0.0001721 the limit holds: (1.9978 ± 0.0021)e-04"
    assert _percent(1.5e-15) == "better than 0.0001 %" and _percent(0.0024) == "0.24 %"
