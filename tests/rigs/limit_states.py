"""Limit states of the reliability benchmarks of otbenchmark as problems, with their reference
probabilities.

Most are those of the Black-box Reliability Challenge 2019 of TNO (Rozsas & Slobbe, "RP" and their
number). Components that the challenge puts together by min and max are limits of their own here,
in series and parallel systems."""

import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from scipy import stats

import jaxclear as jc

Above, Below = jc.limit_state.Above, jc.limit_state.Below
Series, Parallel = jc.limit_state.Series, jc.limit_state.Parallel
Normal, Uniform = jc.distribution.Normal, jc.distribution.Uniform
REFERENCES = json.loads((Path(__file__).parents[1] / "refdata" / "limit_states.json").read_text())[
    "cases"
]
EULER = 0.5772156649015329
ROOT_2, ROOT_3, ROOT_10 = np.sqrt([2.0, 3.0, 10.0])


def normal(mean, deviation):
    return jc.Dimension(mean, Normal(deviation), unit="1")


def lognormal(mean, deviation):
    spread = np.sqrt(np.log1p((deviation / mean) ** 2))
    median = mean * np.exp(-0.5 * spread**2)
    return jc.Dimension(median, jc.distribution.Lognormal(median, spread=spread), unit="1")


def of_scipy(frozen):
    return jc.Dimension(0.0, jc.distribution.FromScipy(frozen), unit="1")


def uniform(low, high):
    return jc.Dimension((low + high) / 2, Uniform((high - low) / 2), unit="1")


def gumbel(mean, deviation):
    scale = deviation * np.sqrt(6) / np.pi
    return of_scipy(stats.gumbel_r(mean - EULER * scale, scale))


def numbered(*kinds):
    return {f"x{i + 1}": kind for i, kind in enumerate(kinds)}


def buckled(x1, x2, x3, x4, x5, x6, x7):
    above = x4**2 - 4 * x5 * x6 * x7**2 + x4 * (x6 + 4 * x5 + 2 * x6 * x7)
    below = x4 * x5 * (x4 + x6 + 2 * x6 * x7)
    return 15.59e4 - x1 * x2**3 / (2 * x3**3) * above / below


def stepped(x1, x2):
    first = jnp.where(x1 <= 3.5, 0.85 - 0.1 * x1, 4 - x1)
    return {"a": first, "b": jnp.where(x2 <= 2.0, 2.3 - x2, 0.5 - 0.1 * x2)}


def pressed(x1, x2, x3, x4, x5):
    first = 0.847 + 0.96 * x2 + 0.986 * x3 - 0.216 * x4 + 0.077 * x2**2 + 0.11 * x3**2
    first += 7 / 378 * x4**2 - x3 * x2 - 0.106 * x2 * x4 - 0.11 * x3 * x4
    return {
        "a": first,
        "b": 84000 * x1 / jnp.sqrt(x3**2 + x4**2 - x3 * x4 + 3 * x5**2) - 1,
        "c": 84000 * x1 / abs(x4) - 1,
    }


def cables(x1, x2, x3, x4, x5):
    thin = {f"half{i}": x - x5 / 2 for i, x in ((2, x2), (3, x3), (4, x4))}
    return {"whole1": x1 - x5, "whole2": x2 - x5, "whole3": x3 - x5, "whole4": x4 - x5} | thin


def waves(x1, x2):
    width, far = x1 - x2, 5 / ROOT_2 - 2.2
    bow, slope = 0.2 + 0.6 * width**4, width / ROOT_2
    return {"a": bow - slope, "b": bow + slope, "c": far + width, "d": far - width}


def four_branches(x1, x2):
    bow, along, far = 3 + 0.1 * (x1 - x2) ** 2, (x1 + x2) / ROOT_2, 7 / ROOT_2
    return {"a": bow - along, "b": bow + along, "c": far + x1 - x2, "d": far + x2 - x1}


def total(**x):
    return sum(x.values())


def bowl(**x):
    first, *rest = x.values()
    return 0.1 * sum(own**2 for own in rest) - first - 4.5


def below_zero(*names):
    return [Below(name, 0.0) for name in names]


def in_series(*names):
    return Series(*below_zero(*names))


ALONE = Below("response", 0.0)
STANDARD = numbered(normal(0, 1), normal(0, 1))
# Function, variables and limit by name.
CASES = {
    "RP8": (
        lambda x1, x2, x3, x4, x5, x6: x1 + 2 * x2 + 2 * x3 + x4 - 5 * x5 - 5 * x6,
        numbered(*[lognormal(120, 12)] * 4, lognormal(50, 10), lognormal(40, 8)),
        ALONE,
    ),
    "RP14": (
        lambda x1, x2, x3, x4, x5: (
            x1 - 32 / (jnp.pi * x2**3) * jnp.sqrt(x3**2 * x4**2 / 16 + x5**2)
        ),
        numbered(
            uniform(70, 80), normal(39, 0.1), gumbel(1500, 350), normal(400, 0.1),
            normal(250000, 35000),
        ),
        ALONE,
    ),
    "RP22": (lambda x1, x2: 2.5 - (x1 + x2) / ROOT_2 + 0.1 * (x1 - x2) ** 2, STANDARD, ALONE),
    "RP24": (
        lambda x1, x2: 2.5 - 0.2357 * (x1 - x2) + 0.00463 * (x1 + x2 - 20) ** 4,
        numbered(normal(10, 3), normal(10, 3)),
        ALONE,
    ),
    "RP25": (
        lambda x1, x2: {"a": x1**2 - 8 * x2 + 16, "b": -16 * x1 + x2 + 32},
        STANDARD,
        Parallel(*below_zero("a", "b")),
    ),
    "RP28": (
        lambda x1, x2: x1 * x2,
        numbered(normal(78064, 11710), normal(0.0104, 0.00156)),
        Below("response", 146.14),
    ),
    "RP31": (lambda x1, x2: 2 - x2 + 256 * x1**4, STANDARD, ALONE),
    "RP33": (
        lambda x1, x2, x3: {"a": -x1 - x2 - x3 + 3 * ROOT_3, "b": 3 - x3 + 0 * x1 * x2},
        numbered(*[normal(0, 1)] * 3),
        in_series("a", "b"),
    ),
    "RP35": (
        lambda x, y: {"a": 2 - y + jnp.exp(-0.1 * x**2) + (0.2 * x) ** 4, "b": 4.5 - x * y},
        {"x": normal(0, 1), "y": normal(0, 1)},
        in_series("a", "b"),
    ),
    "RP38": (
        buckled,
        numbered(*[
            normal(mean, 0.1 * mean) for mean in (350, 50.8, 3.81, 173, 9.38, 33.1, 0.036)
        ]),
        ALONE,
    ),
    "RP53": (
        lambda x1, x2: jnp.sin(5 * x1 / 2) + 2 - (x1 * x1 + 4) * (x2 - 1) / 20,
        numbered(normal(1.5, 1), normal(2.5, 1)),
        ALONE,
    ),
    "RP55": (waves, numbered(*[uniform(-1, 1)] * 2), in_series("a", "b", "c", "d")),
    "RP54": (total, numbered(*[of_scipy(stats.expon())] * 20), Below("response", 8.951)),
    "RP57": (
        lambda x1, x2: {
            "a": -(x1**2) + x2**3 + 3,
            "b": 2 - x1 - 8 * x2,
            "c": (x1 + 3) ** 2 + (x2 + 3) ** 2 - 4,
        },
        STANDARD,
        Series(Parallel(*below_zero("a", "b")), *below_zero("c")),
    ),
    "RP75": (lambda x1, x2: 3 - x1 * x2, STANDARD, ALONE),
    "RP89": (
        lambda x1, x2: {"a": -(x1**2) - x2 + 8, "b": -x1 / 5 - x2 + 6},
        STANDARD,
        in_series("a", "b"),
    ),
    "RP107": (lambda **x: 5 * ROOT_10 - total(**x), numbered(*[normal(0, 1)] * 10), ALONE),
    "RP110": (stepped, STANDARD, in_series("a", "b")),
    "RP111": (lambda x1, x2: 12.5 - abs(x1 * x2), STANDARD, ALONE),
    "RP63": (bowl, numbered(*[normal(0, 1)] * 100), ALONE),
    "RP91": (
        pressed,
        numbered(
            normal(0.07433, 0.005), normal(0.1, 0.01), normal(13, 60), normal(4751, 48),
            normal(-684, 11),
        ),
        Series(*below_zero("a", "b", "c")),
    ),
    "RP60": (
        cables,
        numbered(
            lognormal(2200, 220), lognormal(2100, 210), lognormal(2300, 230), lognormal(2000, 200),
            lognormal(1200, 480),
        ),
        Series(
            *below_zero("whole1"),
            Parallel(
                *below_zero("whole4"),
                Series(*below_zero("whole2", "whole3")),
                Series(*below_zero("half2", "half3", "half4")),
            ),
        ),
    ),
    "RP77": (
        lambda x1, x2, x3: jnp.where(x3 <= 5.0, x1 - x2 - x3, x3 - x2),
        numbered(normal(10, 0.5), normal(0, 1), normal(4, 1)),
        ALONE,
    ),
    "Four-branch serial system": (
        four_branches,
        STANDARD,
        Series(*below_zero("a", "b", "c", "d")),
    ),
    "R-S": (
        lambda x1, x2: x1 - x2,
        numbered(normal(4, 1), normal(2, 1)),
        ALONE,
    ),
    "Axial stressed beam": (
        lambda x1, x2: x1 - x2 / (100 * jnp.pi),
        numbered(
            jc.Dimension(
                np.exp(5.69881),
                jc.distribution.Lognormal(np.exp(5.69881), spread=0.0997513),
                unit="1",
            ),
            normal(75000, 5000),
        ),
        ALONE,
    ),
}  # fmt: skip


def case(name):
    """The problem, limit and reference of a case: (low, high), between which published values and
    5 minutes of plain Monte Carlo lie."""
    function, variables, limit = CASES[name]
    return jc.FunctionProblem(function, variables), limit, REFERENCES[name]
