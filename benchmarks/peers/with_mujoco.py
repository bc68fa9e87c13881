"""The slider-crank of `peers.rig` in MuJoCo (C) and in MJX, in their own joint coordinates, the
contact as an applied force.

MuJoCo's contacts know neither a journal in a hole nor Hertz's law, so the contact law is ours: for
C the compiled law as a callback, for MJX the law in JAX. Their part is the
equations of motion. A flywheel keeps the crank's speed.
"""

import ctypes
import os
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.by_hand.slider_crank import CENTRE
from benchmarks.peers import rig
from benchmarks.peers.rig import Answer

# Inertia of the crank [kg m2].
FLYWHEEL = 1e9
# MJX in a batch: samples times steps are cut down to a few saving intervals of few steps, and
# scaled up.
FEW_SAVES, FEW_STEPS = 4, 25
# Forces as in `by_hand.slider_crank`.
CALLBACK = r"""
#define _GNU_SOURCE
#include <math.h>
typedef struct {
    double crank, rod, slider, inertia, pull, speed, radius, modulus, damping, slowest, mu, inner;
    double outer;
} P;
typedef struct { double a, b, delta, rate, normal; } F;

static inline F forces(const P *p, double c, double k, double ct, double st, double phi, double x,
                       double w, double u, double m)
{
    double sphi, cphi;
    sincos(phi, &sphi, &cphi);
    double ex = x - p->crank * ct - p->rod * cphi, ey = -p->crank * st - p->rod * sphi;
    double moment = p->pull * (st * cphi - ct * sphi), square = ex * ex + ey * ey;
    F f = {moment / p->inertia, 0, -c, 0, 0};
    if (square < CENTRE * CENTRE * c * c) return f;
    double vx = u + p->crank * p->speed * st + p->rod * w * sphi;
    double vy = -p->crank * p->speed * ct - p->rod * w * cphi;
    double r = sqrt(square), nx = ex / r, ny = ey / r;
    double delta = f.delta = r - c, rate = f.rate = nx * vx + ny * vy;
    if (delta <= 0) return f;
    double loss = 1 + p->damping * rate / fmax(m, p->slowest);
    double normal = f.normal = k * delta * sqrt(delta) * fmax(loss, 0);
    double reach = p->radius + 0.5 * delta, slip = nx * vy - ny * vx - w * reach;
    double share = fmin(fmax((fabs(slip) - p->inner) / (p->outer - p->inner), 0), 1);
    double drag = -copysign(p->mu * share, slip) * normal;
    double fx = -normal * nx - drag * ny, fy = -normal * ny + drag * nx;
    moment -= p->rod * (cphi * fy - sphi * fx) + reach * drag;
    f.a = moment / p->inertia;
    f.b = fx / p->slider;
    return f;
}

#include <mujoco/mujoco.h>
/* userdata: clearance; impact speed; gap and rate when last open; whether closed; peak force */
void passive(const mjModel *m, mjData *d)
{
    const P *p = (const P *)m->numeric_data;
    double *s = d->userdata, c = s[0], st, ct;
    double k = 4.0 / 3.0 * p->modulus * sqrt((p->radius - c) * p->radius / c);
    double phi = d->qpos[0] + d->qpos[1], w = d->qvel[0] + d->qvel[1];
    sincos(d->qpos[0], &st, &ct);
    F f = forces(p, c, k, ct, st, phi, d->qpos[2], w, d->qvel[2], s[1]);
    if (f.delta <= 0) {
        s[1] = s[3] = f.rate;
        s[2] = f.delta;
        s[4] = 0;
        return;
    }
    if (s[4] == 0) {
        s[1] = s[3] - (f.rate - s[3]) * s[2] / (f.delta - s[2]);
        s[4] = 1;
        f = forces(p, c, k, ct, st, phi, d->qpos[2], w, d->qvel[2], s[1]);
    }
    s[5] = fmax(s[5], f.normal);
    d->qfrc_passive[1] += f.a * p->inertia - p->pull * (st * cos(phi) - ct * sin(phi));
    d->qfrc_passive[2] += f.b * p->slider;
}
"""
MODEL = """
<mujoco>
  <option integrator="RK4" timestep="{step!r}" gravity="0 0 0">
    <flag contact="disable" constraint="disable"/>
  </option>
  <size nuserdata="6"/>
  <custom><numeric name="rig" data="{numbers}"/></custom>
  <worldbody>
    <body>
      <joint type="hinge" axis="0 0 1" armature="{flywheel}"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <body pos="{p.crank} 0 0">
        <joint type="hinge" axis="0 0 1"/>
        <inertial pos="{half} 0 0" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>
      </body>
    </body>
    <body>
      <joint type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="{p.slider}" diaginertia="1 1 1"/>
    </body>
  </worldbody>
</mujoco>
"""
P = rig.LAWS["captured"]
START = ((0.0, 0.0, P.crank + P.rod), (P.speed, -P.crank * P.speed / P.rod - P.speed, 0.0))


@cache
def _model(step: float):
    """The mechanism, by joint coordinates: crank, rod relative to the crank, slider."""
    import mujoco

    text = MODEL.format(
        step=step,
        p=P,
        half=rig.ROD / 2,
        mass=rig.ROD_MASS,
        inertia=rig.ROD_INERTIA,
        flywheel=FLYWHEEL,
        numbers=" ".join(f"{number:.17g}" for number in P),
    )
    return mujoco.MjModel.from_xml_string(text)


@cache
def install(source: str) -> bool:
    """Set a contact (`passive` of a source in C) as a compiled callback; False without a compiler:
    the mechanism then moves without contact.
    """
    import mujoco

    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        return False
    folder = Path(tempfile.mkdtemp(prefix="jaxclear_peers_"))
    (folder / "peers.c").write_text(source)
    flags = ["-O3", "-march=native", "-fno-math-errno", "-shared", "-fPIC", f"-DCENTRE={CENTRE}"]
    headers = f"-I{Path(mujoco.__file__).parent / 'include'}"
    names = [str(folder / "peers.c"), "-o", str(folder / "peers.so"), "-lm"]
    subprocess.run([compiler, *flags, headers, *names], check=True)
    library = ctypes.CDLL(str(folder / "peers.so"))
    shutil.rmtree(folder)
    pointers = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)
    mujoco.set_mjcb_passive(ctypes.cast(library.passive, pointers))
    return True


def _memory(clearance):
    return np.array([clearance, 0.0, -clearance, 0.0, 0.0, 0.0])


def mujoco_run(question: rig.Question, per_save: float) -> Answer:
    """One run of mj_step with MuJoCo's Runge-Kutta."""
    import mujoco

    per_save = int(per_save)
    model = _model(question.interval / per_save)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = START
    data.userdata[:] = _memory(rig.CLEARANCE)
    places = np.empty(question.saves)
    for save in range(question.saves):
        mujoco.mj_step(model, data, per_save)
        places[save] = data.qpos[2]
    return Answer(places, float(data.userdata[5]), question.saves * per_save)


def mujoco_batch(question: rig.Question, per_save: float, clearances: np.ndarray) -> np.ndarray:
    """mujoco.batch on all threads."""
    from mujoco.batch import Batch

    sims = Batch(
        _model(question.interval / int(per_save)), nsim=len(clearances), nthread=os.cpu_count()
    )
    places, speeds, memories = (sims.bind(name) for name in ("qpos", "qvel", "userdata"))
    places[:], speeds[:] = START
    memories[:] = np.stack([_memory(c) for c in clearances])
    sims.step(nstep=question.saves * int(per_save))
    return np.stack([memories[:, 5], places[:, 2]], axis=1)


def mujoco_programs(question: rig.Question) -> list[rig.Program]:
    """MuJoCo in C."""
    name = (
        "MuJoCo C, RK4"
        if install(CALLBACK)
        else "MuJoCo C, RK4, WITHOUT the contact: a lower bound"
    )
    batch = None
    if _has_batch():
        batch = rig.Batch(
            lambda k, c: mujoco_batch(question, k, c), f"mujoco.batch, {os.cpu_count()} threads"
        )
    ladder = rig.steps_ladder(3e-6, 2e-8)
    return [rig.Program(name, "captured", ladder, lambda k: mujoco_run(question, k), batch)]


def _has_batch() -> bool:
    import mujoco

    there = (Path(mujoco.__file__).parent / "batch.py").exists()
    if not there:
        print(
            "This MuJoCo has no mujoco.batch, so it is left out of the batches; `pip install "
            "'mujoco>=4'` brings it."
        )
    return there


def _jax_contact(c, stiffness, q, v, memory):
    """(generalised force on the rod, on the slider, indentation, its rate, normal force); memory
    below 0: still open.
    """
    st, ct, sp, cp = jnp.sin(q[0]), jnp.cos(q[0]), jnp.sin(q[0] + q[1]), jnp.cos(q[0] + q[1])
    w = v[0] + v[1]
    ex, ey = q[2] - P.crank * ct - P.rod * cp, -P.crank * st - P.rod * sp
    vx, vy = v[2] + P.crank * v[0] * st + P.rod * w * sp, -P.crank * v[0] * ct - P.rod * w * cp
    square = ex * ex + ey * ey
    away = square > (CENTRE * c) ** 2
    r = jnp.sqrt(jnp.where(away, square, 1.0))
    nx, ny = ex / r, ey / r
    delta, rate = jnp.where(away, r - c, -c), nx * vx + ny * vy
    depth = jnp.maximum(delta, 0.0)
    impact = jnp.maximum(jnp.where(memory < 0, rate, memory), P.slowest)
    normal = stiffness * depth * jnp.sqrt(depth) * jnp.maximum(1 + P.damping * rate / impact, 0.0)
    reach = P.radius + 0.5 * delta
    slip = nx * vy - ny * vx - w * reach
    drag = (
        -jnp.sign(slip)
        * P.mu
        * jnp.clip((jnp.abs(slip) - P.inner) / (P.outer - P.inner), 0.0, 1.0)
        * normal
    )
    fx, fy = -normal * nx - drag * ny, -normal * ny + drag * nx
    return -(P.rod * (cp * fy - sp * fx) + reach * drag), fx, delta, rate, normal


@cache
def _mjx_program(saves: int):
    """run(clearance, step, steps per saving interval): (slider's places, peak force)."""
    from mujoco import mjx

    model = mjx.put_model(_model(1e-6))
    blank = mjx.make_data(_model(1e-6))

    def run(clearance, h, per_save):
        stiffness = 4 / 3 * P.modulus * jnp.sqrt((P.radius - clearance) * P.radius / clearance)

        def acceleration(q, v, memory):
            moment, push, *_ = _jax_contact(clearance, stiffness, q, v, memory)
            applied = jnp.stack([jnp.zeros_like(moment), moment, push])
            return mjx.forward(model, blank.replace(qpos=q, qvel=v, qfrc_applied=applied)).qacc

        def step(_, carry):
            q, v, memory, gap, rate, peak = carry
            a1 = acceleration(q, v, memory)
            v2 = v + 0.5 * h * a1
            a2 = acceleration(q + 0.5 * h * v, v2, memory)
            v3 = v + 0.5 * h * a2
            a3 = acceleration(q + 0.5 * h * v2, v3, memory)
            v4 = v + h * a3
            a4 = acceleration(q + h * v3, v4, memory)
            q = q + h / 6 * (v + 2 * (v2 + v3) + v4)
            v = v + h / 6 * (a1 + 2 * (a2 + a3) + a4)
            *_, new_gap, new_rate, normal = _jax_contact(clearance, stiffness, q, v, memory)
            touch = rate - (new_rate - rate) * gap / (new_gap - gap)
            memory = jnp.where(new_gap <= 0, -1.0, jnp.where(memory < 0, touch, memory))
            return q, v, memory, new_gap, new_rate, jnp.maximum(peak, normal)

        def save(carry, _):
            carry = jax.lax.fori_loop(0, per_save, step, carry)
            return carry, carry[0][2]

        zero = jnp.zeros(())
        first = (*(jnp.asarray(part) for part in START), zero - 1, zero - clearance, zero, zero)
        last, places = jax.lax.scan(save, first, length=saves)
        return places, last[-1]

    return run


@cache
def _mjx_alone(saves: int):
    return jax.jit(_mjx_program(saves))


@cache
def _mjx_batch():
    return jax.jit(jax.vmap(_mjx_program(FEW_SAVES), in_axes=(0, None, None)))


def mjx_run(question: rig.Question, per_save: float) -> Answer:
    """One run; the law's own Runge-Kutta around mjx.forward, because mjx.step holds applied forces
    over its stages.
    """
    found = _mjx_alone(question.saves)(rig.CLEARANCE, question.interval / per_save, int(per_save))
    places, peak = jax.block_until_ready(found)
    return Answer(np.asarray(places), float(peak), question.saves * int(per_save))


def mjx_programs(question: rig.Question) -> list[rig.Program]:
    """MJX in float64."""

    def go(per_save, clearances):
        places, peaks = _mjx_batch()(
            jnp.asarray(clearances), question.interval / per_save, FEW_STEPS
        )
        return np.stack([peaks, places[:, -1]], axis=1)

    def share(per_save):
        return FEW_SAVES * FEW_STEPS / (question.saves * per_save)

    batch = rig.Batch(go, f"jax.vmap, {FEW_SAVES * FEW_STEPS} steps scaled up", share)
    ladder = rig.steps_ladder(3e-6, 2e-8)
    return [rig.Program("MJX, RK4", "captured", ladder, lambda k: mjx_run(question, k), batch)]
