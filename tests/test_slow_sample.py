"""CI runs one case of each slow function, and more of those with many."""

from types import SimpleNamespace

import pytest


class Case:
    def __init__(self, name, mark=None):
        self.nodeid, self.mark = name, mark

    def get_closest_marker(self, name):
        return self.mark.mark if self.mark is not None and self.mark.name == name else None


def test_the_sample_has_one_case_of_each_slow_function(request):
    plugins = request.config.pluginmanager.get_plugins()
    (conftest,) = (p for p in plugins if hasattr(p, "few_programs"))
    cases = [
        *(Case(f"a.py::one[{i}]", pytest.mark.slow) for i in range(5)),
        *(Case(f"a.py::two[{i}]", pytest.mark.slow if i else None) for i in range(3)),
        *(Case(f"a.py::many[{i}]", pytest.mark.slow) for i in range(80)),
        Case("a.py::whole", pytest.mark.slow),
        Case("a.py::quick"),
        Case("a.py::longest", pytest.mark.slow(sample=False)),
    ]
    chosen = []
    for sample in (True, True, False):
        items, config = cases.copy(), SimpleNamespace(getoption=lambda name, on=sample: on)
        conftest.pytest_collection_modifyitems(config, items)
        chosen.append([item.nodeid for item in items])
    functions = [name.partition("[")[0] for name in chosen[0]]
    assert functions == ["a.py::one", "a.py::two", *3 * ["a.py::many"], "a.py::whole"]
    assert "a.py::two[0]" not in chosen[0]
    assert chosen[0] == chosen[1] and len(chosen[2]) == len(cases)
