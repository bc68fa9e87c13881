"""Bad input is answered with a sentence: every argument of every class with wrong kinds and wrong
ranges, misspelt names, the mistakes of newcomers, and every argument of public functions."""

import pytest

from tests.bad_input.answers import CLASSES, all_cases, judged


@pytest.fixture(scope="module")
def answers():
    return [(case, *judged(case)) for case in all_cases(runs=False)]


def test_there_are_many_bad_inputs(answers):
    assert len(answers) > 3000
    assert {case.group for case, *_ in answers} == {
        "constructors",
        "names",
        "by hand",
        "command line",
    }


def other_answers(answers):
    return [
        f"{found}: {case.label}: {said[:150]}"
        for case, found, said in answers
        if found != CLASSES[0]
    ]


@pytest.mark.parametrize("group", ["constructors", "names", "by hand", "command line"])
def test_every_bad_input_is_answered_with_a_sentence(answers, group):
    wrong = other_answers([answer for answer in answers if answer[0].group == group])
    assert not wrong, "\n".join(wrong)


@pytest.mark.slow
def test_every_bad_argument_of_a_function_is_answered_with_a_sentence():
    wrong = other_answers([(case, *judged(case)) for case in all_cases(runs=True)])
    assert not wrong, "\n".join(wrong)
