"""Bad input is answered with a sentence: every argument of every class with wrong kinds and wrong
ranges, misspelt names, and the mistakes of newcomers. The benchmark adds those that compile a run.
"""

import pytest

from benchmarks.claims.bad_input import CLASSES, all_cases, judged


@pytest.fixture(scope="module")
def answers():
    return [(case, *judged(case)) for case in all_cases(quick=True)]


def test_there_are_many_bad_inputs(answers):
    assert len(answers) > 3000
    assert {case.group for case, *_ in answers} == {
        "constructors",
        "names",
        "by hand",
        "command line",
    }


@pytest.mark.parametrize("group", ["constructors", "names", "by hand", "command line"])
def test_every_bad_input_is_answered_with_a_sentence(answers, group):
    wrong = [
        f"{found}: {case.label}: {said[:150]}"
        for case, found, said in answers
        if case.group == group and found != CLASSES[0]
    ]
    assert not wrong, "\n".join(wrong)
