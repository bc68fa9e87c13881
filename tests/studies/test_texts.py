"""Problems told by the same texts are one: of a function, what it does and with what."""

import functools
import importlib
import subprocess
import sys
from types import ModuleType
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest

import jaxclear as jc
from jaxclear.ground.description import describe
from jaxclear.studies.store.digest import difference, first_difference, in_texts

MODULE = """
import functools
import jax
import jax.numpy as jnp

FACTOR = {factor}

def inner(x):
    return FACTOR * x

def by_global(v):
    return inner(v["a"])

def by_nested(v):
    turned = lambda x: {nested} * x
    return turned(v["a"])

def by_keyword(v, *, factor={factor}):
    return factor * v["a"]

by_partial = functools.partial(lambda factor, v: factor * v["a"], {factor})
by_jit = jax.jit(by_global)
by_set = lambda v: jnp.sum(jnp.asarray([v[n] for n in ("a", "b") if n in {{"a", "b", "c"}}]))

def again(n):
    return {factor} if n == 0 else again(n - 1)

def by_itself(v):
    return again(3) * v["a"]

class Law:
    def __init__(self):
        self.factor = {factor}

    def __call__(self, v):
        return self.factor * v["a"]

by_object = Law()
"""
NAMES = ["by_global", "by_partial", "by_jit", "by_itself", "by_object", "by_keyword"]


def written(factor=2.0, nested=2.0):
    held = {"__name__": "a_users_module"}
    exec(MODULE.format(factor=factor, nested=nested), held)
    return held


def texts_of(thing):
    return describe([("", thing)])


def asked(function):
    variables = {"a": jc.Dimension(1.0, tolerance=0.1), "b": jc.Dimension(1.0, tolerance=0.1)}
    return jc.FunctionProblem(lambda a, b: function({"a": a, "b": b}), variables)


@pytest.mark.parametrize("name", [*NAMES, "by_nested"])
def test_what_a_function_uses_belongs_to_it(name):
    one, same, other = (written(factor, factor)[name] for factor in (2.0, 2.0, 3.0))
    assert texts_of(one) == texts_of(same) != texts_of(other)


def test_problems_of_functions_that_differ_outside_are_two():
    one, same, other = (asked(written(factor)["by_global"]) for factor in (2.0, 2.0, 3.0))
    assert in_texts(one) == in_texts(same)
    assert difference(one, same) == ""
    assert difference(one, other) == "a_users_module.FACTOR is 2.0 there, 3.0 here"


# A user's objects, in which EDIT is 2.0, 3.0 after an edit.
OBJECTS = {
    "a lambda": "f = lambda x: EDIT * x",
    "a closure": "def make(k):\n    return lambda x: k * x\nf = make(EDIT)",
    "a default": "def f(x, k=EDIT): return k * x",
    "a global": "K = EDIT\ndef f(x): return K * x",
    "a function called": "def g(x): return EDIT * x\ndef f(x): return g(x)",
    "a decorator of its own": """
def scaled(function):
    @functools.wraps(function)
    def inner(x):
        return EDIT * function(x)
    return inner
@scaled
def f(x): return x""",
    "a decorator that is a class": """
class Scaled:
    def __init__(self, function): functools.update_wrapper(self, function)
    def __call__(self, x): return EDIT * self.__wrapped__(x)
f = Scaled(lambda x: x)""",
    "a method": "class L:\n    k = 1.0\n    def __call__(self, x): return EDIT * x\nf = L()",
    "a class without numbers": "class L:\n    def __call__(self, x): return EDIT * x\nf = L()",
    "a value of the class": "class L:\n    K = EDIT\n    def __call__(self, x): return x\nf = L()",
    "a thing of the class": """
class Law:
    def __init__(self, k): self.k = k
class L:
    law = Law(EDIT)
    def __call__(self, x): return self.law.k * x
f = L()""",
    "a number": "class L:\n    def __init__(self): self.k = EDIT\nf = L()",
    "a bound method": """
class L:
    def __init__(self): self.k = EDIT
    def m(self, x): return self.k * x
f = L().m""",
    "a partial": "f = functools.partial(lambda k, x: k * x, EDIT)",
    "a parent": """
class P:
    def h(self, x): return EDIT * x
class L(P):
    def __call__(self, x): return self.h(x)
f = L()""",
    "an operator": "class L:\n    def __getitem__(self, i): return EDIT * i\nf = L()",
    "a cached property": """
class L:
    @functools.cached_property
    def k(self): return EDIT
f = L()""",
    "a property": "class L:\n    @property\n    def k(self): return EDIT\nf = L()",
    "a static method": "class L:\n    @staticmethod\n    def k(): return EDIT\nf = L()",
    "a jitted function": "@jax.jit\ndef f(x): return EDIT * x",
    "a module of equinox": """
class L(eqx.Module):
    k: float
    def __call__(self, x): return EDIT * self.k * x
f = L(1.0)""",
    "an array": "f = jnp.arange(EDIT)",
    "a class that shows itself": """
class L:
    def __init__(self): self.k = EDIT
    def __repr__(self): return "L()"
f = L()""",
    "what a class does that shows itself": """
class L:
    def __repr__(self): return "L()"
    def __call__(self, x): return EDIT * x
f = L()""",
    "a slot": "class L:\n    __slots__ = ('k',)\n    def __init__(self): self.k = EDIT\nf = L()",
    "a private slot of a parent": """
class P:
    __slots__ = ("__k",)
    def __init__(self): self.__k = EDIT
class L(P):
    __slots__ = ()
f = L()""",
    "a dictionary of its own": """
class L(dict):
    def k(self): return EDIT
f = L(a=1.0)""",
    "a tuple that holds more": """
class L(tuple):
    pass
f = L((1.0,))
f.k = EDIT""",
}
IMPORTS = "import functools\nimport equinox as eqx\nimport jax\nimport jax.numpy as jnp\n"


@pytest.mark.parametrize("module", ["__main__", "a_users_module"])
@pytest.mark.parametrize("name", OBJECTS)
def test_edits_are_noticed_and_moves_are_not(name, module, monkeypatch):
    """Nor is whether the file is a script, or a module of a package that is imported."""
    script = ModuleType("__main__")
    script.__file__ = "/somewhere/a_users_module.py"
    monkeypatch.setitem(sys.modules, "__main__", script)

    def told(edit, before="", module=module):
        held = {"__name__": module}
        exec(before + IMPORTS + OBJECTS[name].replace("EDIT", edit), held)
        return texts_of(held["f"])

    one = told("2.0")
    assert one == told("2.0", "# a comment\n\n")
    assert one == told("2.0", module="a_users_package.a_users_module")
    assert one != told("3.0")


def test_what_a_library_makes_of_a_function_is_another():
    """A derivative of it, or its own rule for one."""
    square = lambda x: x**2
    made = (square, jax.grad(square), jax.vmap(square), jax.jacrev(square))
    assert len({str(texts_of(own)) for own in made}) == len(made)
    assert texts_of(jax.grad(square)) == texts_of(jax.grad(lambda x: x**2))

    def with_rule(slope):
        f = jax.custom_jvp(lambda x: x)
        f.defjvp(lambda x, v: (x[0], slope * v[0]))
        return f

    assert texts_of(with_rule(1.0)) == texts_of(with_rule(1.0)) != texts_of(with_rule(2.0))


def test_modules_that_a_users_module_uses_belong_to_it(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    package = tmp_path / "a_users_package"
    package.mkdir()
    (package / "__init__.py").write_text("from a_users_package import inner\n")

    def told(factor):
        (package / "inner.py").write_text(f"f = lambda x: {factor} * x\n")
        for name in ("a_users_package", "a_users_package.inner"):
            sys.modules.pop(name, None)
        return texts_of(importlib.import_module("a_users_package"))

    assert told("2.0") == told("2.0") != told("33.0")


def test_things_of_one_name_in_two_modules_are_two():
    def told(second):
        one, other = ({"__name__": f"{name}.settings"} for name in "ab")
        exec("K = 1.0\ndef f(x): return K * x", one)
        exec(f"K = {second}\ndef g(x): return K * x", other)
        return texts_of([one["f"], other["g"]])

    assert told("2.0") == told("2.0") != told("3.0")


def test_what_a_class_holds_beside_its_functions_belongs_to_it():
    """Not what a field has by default, which each object tells."""

    class Settings:
        factor = 2.0
        _room = (1.0, 2.0)

    def scaled(v):
        return Settings.factor * v["a"]

    told = texts_of(scaled)
    Settings.factor = 3.0
    assert "factor is 2.0 there, 3.0 here" in first_difference(told, texts_of(scaled))
    Settings.factor, Settings._room = 2.0, (1.0, 3.0)
    assert "_room[1] is 2.0 there, 3.0 here" in first_difference(told, texts_of(scaled))

    class Pair(NamedTuple):
        first: float = 1.0

    assert not [part for part in texts_of(Pair()) if "_field" in part]

    class Law(eqx.Module):
        factor: float = 2.0

    assert texts_of(Law(3.0)) == {"": "Law", ".factor": "3.0"} | {
        name: text for name, text in texts_of(Law(4.0)).items() if name.startswith("class")
    }


def test_long_texts_that_differ_at_their_end_are_two():
    assert texts_of("x" * 100 + "1") != texts_of("x" * 100 + "2")
    assert texts_of(jnp.arange(3)) != texts_of(jnp.arange(3.0))


def test_texts_hold_no_address():
    for thing in (jnp.sin, jax.jit(jnp.cos), functools.partial(jnp.add, 1.0), eqx.Module()):
        assert not any(" at 0x" in text for text in texts_of(thing).values())
        assert not any("__vectorcall" in part for part in texts_of(thing))


PROGRAM = """
import sys
sys.path.insert(0, sys.argv[1])
import a_users_own, hashlib
from jaxclear.ground.description import describe
found = describe([("", [getattr(a_users_own, name) for name in sys.argv[2:]])])
print(hashlib.sha256(repr(sorted(found.items())).encode()).hexdigest())
"""


@pytest.mark.slow
def test_texts_are_the_same_in_another_process(tmp_path):
    (tmp_path / "a_users_own.py").write_text(MODULE.format(factor=2.0, nested=2.0))
    arguments = [sys.executable, "-c", PROGRAM, str(tmp_path), *NAMES, "by_set", "by_nested"]
    told = {subprocess.check_output(arguments, text=True) for _ in range(3)}
    assert len(told) == 1
