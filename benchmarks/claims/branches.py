"""How often 95 % intervals of derivatives hold where few parts take another branch.

    python -m benchmarks.claims.branches [--quick] [--cases puck ...] [--repetitions N]
        [--json FILE]

Responses of 3 and of 8 normal variables whose derivatives are known in closed form: smooth ones, a
kink and a jump that 0.02 to 0.6 % of the parts are beyond, and waves that no polynomial takes up;
and a puck between two walls, whose place after one to eight bounces has the slope of the other sign
where a part has one bounce more or less. A rigid puck's places are told at once, so its truth is a
quadrature of 2^18 points. "wrong yet trusted" is the share of answers that are called agreed and
whose interval does not hold.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy import stats

import jaxclear as jc
from benchmarks.measure import run_tables


def responses(**scores):
    """A few functions of one sum of the variables, and waves."""
    z = jnp.stack(list(scores.values()))
    slopes = jnp.linspace(1.0, 2.0, len(scores))
    u = slopes @ z / jnp.linalg.norm(slopes)
    waves = jnp.sqrt(jnp.arange(2.0, len(scores) + 2.0)) @ z
    return {
        "line": u,
        "cubic": u + 0.1 * u**2 + 0.02 * u**3,
        "exponential": jnp.exp(0.3 * u),
        "sine": jnp.sin(u),
        "kink in the middle": jnp.maximum(u, 0.0),
        "kink at 2.75": u - 2.0 * jnp.maximum(u - 2.75, 0.0),
        "kink at 3.55": u - 2.0 * jnp.maximum(u - 3.55, 0.0),
        "jump at 2.5": u + (u > 2.5),
        "jump at 3.3": u + (u > 3.3),
        "waves": u + 0.3 * jnp.sin(1e4 * waves),
    }


NORMAL = stats.norm
KNOWN = {
    "line": 1.0,
    "cubic": 1.06,
    "exponential": 0.3 * np.exp(0.045),
    "sine": np.exp(-0.5),
    "kink in the middle": 0.5,
    "kink at 2.75": 1.0 - 2.0 * NORMAL.sf(2.75),
    "kink at 3.55": 1.0 - 2.0 * NORMAL.sf(3.55),
    "jump at 2.5": 1.0 + NORMAL.pdf(2.5),
    "jump at 3.3": 1.0 + NORMAL.pdf(3.3),
    "waves": 1.0,
}
# A puck of 0.12 kg that an impulse throws to and fro between two walls (Newton's impact).
MASS, PULSE, BOUNCES = 0.12, 2e-3, 8
PUCK = {"clearance": (4e-3, 4e-5), "restitution": (0.82, 0.014), "impulse": (0.06, 6e-4)}


def _first_touch(clearance, impulse):
    speed = impulse / MASS
    return speed, PULSE + (clearance - impulse * PULSE / (2 * MASS)) / speed


def _instants() -> np.ndarray:
    """One in each nominal flight (flights,) [s]."""
    (clearance, restitution, impulse) = (own[0] for own in PUCK.values())
    speed, at = _first_touch(clearance, impulse)
    found = []
    for _ in range(BOUNCES):
        speed *= restitution
        found.append(at + 0.6 * 2 * clearance / speed)
        at += 2 * clearance / speed
    return np.array(found)


INSTANTS = _instants()


def puck(clearance, restitution, impulse):
    """Places [m] at the instants, from the middle between the walls."""
    speed, at = _first_touch(clearance, impulse)
    place = jnp.zeros(BOUNCES)
    for k in range(20):
        side, speed = 1 - 2 * (k % 2), speed * restitution
        end = at + 2 * clearance / speed
        own = side * (clearance - speed * (INSTANTS - at))
        place = jnp.where((at <= INSTANTS) & (end > INSTANTS), own, place)
        at = end
    return {f"after bounce {k + 1}": place[..., k] for k in range(BOUNCES)}


def of_functions(variables: int) -> tuple[jc.Problem, dict]:
    """The problem, and (truth, its error) by response and variable."""
    names = [f"z{i}" for i in range(variables)]
    slopes = np.linspace(1.0, 2.0, variables)
    slopes /= np.linalg.norm(slopes)
    law = jc.distribution.Normal(1.0)
    problem = jc.FunctionProblem(responses, {name: jc.Dimension(0.0, law) for name in names})
    truth = {
        (response, name): (slope * known, 1e-9)
        for response, known in KNOWN.items()
        for name, slope in zip(names, slopes, strict=True)
    }
    return problem, truth


def of_puck() -> tuple[jc.Problem, dict]:
    """The same, by central differences over common points."""
    normal = jc.distribution.Normal
    problem = jc.FunctionProblem(
        puck, {name: jc.Dimension(mean, normal(spread)) for name, (mean, spread) in PUCK.items()}
    )
    points = stats.norm.ppf(stats.qmc.Sobol(3, rng=1).random_base2(18).clip(1e-12, 1 - 1e-12))
    mean, spread = np.array(list(PUCK.values())).T

    def places(shift):
        found = puck(*jnp.asarray(mean + spread * points + shift).T[:, :, None])
        return {name: float(own.mean()) for name, own in found.items()}

    truth = {}
    for i, name in enumerate(PUCK):
        by_step = []
        for step in (0.1, 0.2):
            shift = np.eye(3)[i] * step * spread[i]
            up, down = places(shift), places(-shift)
            by_step.append({r: (up[r] - down[r]) / (2 * shift[i]) for r in up})
        for response, near in by_step[0].items():
            far = by_step[1][response]
            own = (4 * near - far) / 3
            truth[response, name] = own, 2 * abs(near - far) + 1e-4 * abs(own)
    return problem, truth


def study(title: str, case: tuple, samples: int, repetitions: int) -> list[dict]:
    """Rows: one a response, all variables together."""
    problem, truth = case
    told: dict[str, list] = {response: [] for response, _ in truth}
    for seed in range(repetitions):
        found = jc.sensitivity(problem, sample=samples, seed=1000 + 10 * seed).derivatives
        for key, (exact, own) in truth.items():
            one = found[key]
            scale = max(abs(exact), 1e-12)
            held = abs(one.value - exact) <= one.error + own
            told[key[0]].append(
                ((one.value - exact) / scale, one.error / scale, held, one.trustworthy)
            )
    rows = []
    for response, own in told.items():
        off, half, held, trusted = np.array(own, float).T
        rows.append(
            {
                "responses": title,
                "samples": samples,
                "response": response,
                "derivatives": len(own),
                "held [%]": 100 * held.mean(),
                "rms error [%]": 100 * np.sqrt(np.mean(off**2)),
                "median half width [%]": 100 * np.median(half),
                "wrong yet trusted [%]": 100 * np.mean((held == 0) & (trusted == 1)),
            }
        )
    return rows


CASES = {
    "puck": of_puck,
    "3 variables": lambda: of_functions(3),
    "8 variables": lambda: of_functions(8),
}


def rows_of(options: Any) -> list[dict]:
    """A row for each response and number of samples."""
    rows = []
    for title in options.cases[: 1 if options.quick else None]:
        case = CASES[title]()
        for samples in (256,) if options.quick else (256, 1024):
            rows += study(title, case, samples, 3 if options.quick else options.repetitions)
    return rows


if __name__ == "__main__":
    run_tables(
        {"Derivatives where few parts take another branch": rows_of},
        cases={"nargs": "*", "default": list(CASES), "choices": list(CASES)},
        repetitions={"type": int, "default": 48},
    )
