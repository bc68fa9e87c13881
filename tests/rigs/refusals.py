"""Tests of what is refused, from tables: the sentence, and the call that it answers."""

import pytest


def refusals(table, error=ValueError):
    """A test that each call of {sentence: call} is refused with its sentence."""

    @pytest.mark.parametrize("sentence", table)
    def test_refusal(sentence):
        with pytest.raises(error, match=sentence):
            table[sentence]()

    return test_refusal
