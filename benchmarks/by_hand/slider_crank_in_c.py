"""The slider-crank of `slider_crank` once more in C: the same algorithm, line by line, compiled
for this machine.

The source is a string, so that nothing is built when the package is installed; without a compiler
there is no C program.
"""

import ctypes
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.by_hand.slider_crank import CENTRE, TOUCH_STEPS
from benchmarks.peers.rig import Answer

SOURCE = r"""
#define _GNU_SOURCE
#include <math.h>
typedef struct {
    double crank, rod, slider, inertia, pull, speed, radius, modulus, damping, slowest, mu, inner;
    double outer, memory_time;
} P;
typedef struct { double phi, x, w, u, m; } Y;
typedef struct { double a, b, m, delta, rate, normal; } F;

static inline F forces(const P *p, double c, double k, double ct, double st, double phi, double x,
                       double w, double u, double m)
{
    double sphi, cphi;
    sincos(phi, &sphi, &cphi);
    double ex = x - p->crank * ct - p->rod * cphi, ey = -p->crank * st - p->rod * sphi;
    double moment = p->pull * (st * cphi - ct * sphi), square = ex * ex + ey * ey;
    F f = {moment / p->inertia, 0, 0, -c, 0, 0};
    if (square < CENTRE * CENTRE * c * c) return f;
    double vx = u + p->crank * p->speed * st + p->rod * w * sphi;
    double vy = -p->crank * p->speed * ct - p->rod * w * cphi;
    double r = sqrt(square), nx = ex / r, ny = ey / r;
    double delta = f.delta = r - c, rate = f.rate = nx * vx + ny * vy;
    if (delta <= 0) {
        if (p->memory_time > 0) f.m = (fmax(rate, 0) - m) / p->memory_time;
        return f;
    }
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

static inline Y step(const P *p, double c, double k, double t, double h, Y y, F f, F *end)
{
    double half = 0.5 * h, sm, cm, se, ce, s = h / 6;
    sincos(p->speed * (t + half), &sm, &cm);
    sincos(p->speed * (t + h), &se, &ce);
    double w2 = y.w + half * f.a, u2 = y.u + half * f.b;
    F g = forces(p, c, k, cm, sm, y.phi + half * y.w, y.x + half * y.u, w2, u2, y.m + half * f.m);
    double w3 = y.w + half * g.a, u3 = y.u + half * g.b;
    F i = forces(p, c, k, cm, sm, y.phi + half * w2, y.x + half * u2, w3, u3, y.m + half * g.m);
    double w4 = y.w + h * i.a, u4 = y.u + h * i.b;
    F j = forces(p, c, k, ce, se, y.phi + h * w3, y.x + h * u3, w4, u4, y.m + h * i.m);
    y.phi += s * (y.w + 2 * (w2 + w3) + w4);
    y.x += s * (y.u + 2 * (u2 + u3) + u4);
    y.w += s * (f.a + 2 * (g.a + i.a) + j.a);
    y.u += s * (f.b + 2 * (g.b + i.b) + j.b);
    y.m += s * (f.m + 2 * (g.m + i.m) + j.m);
    *end = forces(p, c, k, ce, se, y.phi, y.x, y.w, y.u, y.m);
    return y;
}

static Y to_touch(const P *p, double c, double *t, double h, Y y, F f)
{
    Y z;
    F g;
    for (int n = 0; n <= TOUCH_STEPS; n++) {
        z = step(p, c, 0, *t, h, y, f, &g);
        if (n < TOUCH_STEPS) h -= g.delta / g.rate;
    }
    *t += h;
    z.m = g.rate;
    return z;
}

double run(const P *p, double c, long saves, long per_save, double h, double *out)
{
    double k = 4.0 / 3.0 * p->modulus * sqrt((p->radius - c) * p->radius / c), peak = 0;
    Y y = {0, p->crank + p->rod, -p->crank * p->speed / p->rod, 0, 0}, z;
    F f = forces(p, c, k, 1, 0, y.phi, y.x, y.w, y.u, y.m), g;
    int closed = 0;
    for (long save = 0; save < saves; save++) {
        for (long i = 0; i < per_save; i++) {
            long n = save * per_save + i;
            double t = n * h, rest = h, ct, st;
            for (;;) {
                z = step(p, c, k, t, rest, y, f, &g);
                if (closed || g.delta <= 0 || p->memory_time > 0) break;
                y = to_touch(p, c, &t, rest, y, f);
                sincos(p->speed * t, &st, &ct);
                f = forces(p, c, k, ct, st, y.phi, y.x, y.w, y.u, y.m);
                rest = (n + 1) * h - t;
                closed = 1;
            }
            closed = g.delta > 0;
            y = z;
            f = g;
            peak = fmax(peak, g.normal);
        }
        out[save] = y.x;
    }
    return peak;
}

void batch(const P *p, const double *clearances, long samples, long saves, long per_save, double h,
           double *out)
{
    #pragma omp parallel for schedule(dynamic, 1)
    for (long j = 0; j < samples; j++) {
        double places[saves];
        out[2 * j] = run(p, clearances[j], saves, per_save, h, places);
        out[2 * j + 1] = places[saves - 1];
    }
}
"""


def compiled(source: str, *flags: str) -> ctypes.CDLL | None:
    """A C program, compiled into a temporary folder and loaded; None without a compiler."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        return None
    folder = Path(tempfile.mkdtemp(prefix="jaxclear_peers_"))
    (folder / "peers.c").write_text(source)
    always = ["-O3", "-march=native", "-fno-math-errno", "-fopenmp", "-shared", "-fPIC"]
    defined = [f"-DTOUCH_STEPS={TOUCH_STEPS}", f"-DCENTRE={CENTRE}"]
    library = folder / "peers.so"
    subprocess.run(
        [compiler, *always, *defined, *flags, str(folder / "peers.c"), "-o", str(library), "-lm"],
        check=True,
    )
    loaded = ctypes.CDLL(str(library))
    shutil.rmtree(folder)
    return loaded


@cache
def library() -> ctypes.CDLL | None:
    """The slider-crank in C."""
    loaded = compiled(SOURCE)
    if loaded is not None:
        loaded.run.restype = ctypes.c_double
    return loaded


def _doubles(array: np.ndarray):
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def run(p, clearance: float, saves: int, per_save: int, h: float) -> Answer:
    """Slider's place at the saving times and the peak force."""
    places, plain = np.empty(saves), np.array(p)
    of = (
        _doubles(plain),
        ctypes.c_double(clearance),
        ctypes.c_long(saves),
        ctypes.c_long(per_save),
        ctypes.c_double(h),
    )
    peak = library().run(*of, _doubles(places))
    return Answer(places, peak, saves * per_save)


def batch(p, clearances: np.ndarray, saves: int, per_save: int, h: float) -> np.ndarray:
    """(peak force, slider's last place) of every sample, on all threads."""
    out, plain = np.empty((len(clearances), 2)), np.array(p)
    counts = (
        ctypes.c_long(len(clearances)),
        ctypes.c_long(saves),
        ctypes.c_long(per_save),
        ctypes.c_double(h),
    )
    library().batch(
        _doubles(plain), _doubles(np.ascontiguousarray(clearances)), *counts, _doubles(out)
    )
    return out
