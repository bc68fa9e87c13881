"""`export_fmu`: a mechanism as an FMI 3.0 unit of machine code."""

import io
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

from jaxclear.fmu.description import IDENTIFIER, KINDS, description
from jaxclear.fmu.link import TARGETS, checked_target, find_compiler, link_library, this_machine
from jaxclear.fmu.unit import Unit
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_name, check_number, expect
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.printing import AbstractShown
from jaxclear.ground.quantity import with_quantities
from jaxclear.integrators.adaptive import Adaptive
from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.integrators.checks import Checks
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.system import wearing_in
from jaxclear.native.standalone import object_file
from jaxclear.simulation.load_steps import checked_by, load_steps
from jaxclear.simulation.simulate import check_run

WORN = (
    'surfaces of joint "{name}" wear, which an FMU does not carry: leave its Wearing out, as a '
    "run of a system is short beside a life, or compute the life by jaxclear.wear_life."
)
NO_PATH = 'the path of an FMU is {path}; it must end in ".fmu", in a folder that there is.'


class Fmu(AbstractShown):
    """An exported unit. `print` shows its size and what is in it.

    Args:
        path: path of the file.
        size: size of the file [bytes].
        target: name of the system that it runs on.
        kinds: "co-simulation" and "model exchange", as far as they are in it.
        inputs: names of its inputs.
        parameters: names of its parameters.
        outputs: names of its outputs.
        slopes: names of inputs and parameters along which it carries slopes.
        notes: sentences on what was left out or not run.
    """

    path: Path = eqx.field(static=True)
    size: int = eqx.field(static=True)
    target: str = eqx.field(static=True)
    kinds: tuple[str, ...] = eqx.field(static=True)
    inputs: tuple[str, ...] = eqx.field(static=True)
    parameters: tuple[str, ...] = eqx.field(static=True)
    outputs: tuple[str, ...] = eqx.field(static=True)
    slopes: tuple[str, ...] = eqx.field(static=True)
    notes: tuple[str, ...] = eqx.field(static=True)

    def _summary(self):
        lines = [
            f"FMU {self.path}: {self.size / 1000:.0f} kB, FMI 3.0, {' and '.join(self.kinds)}, "
            f"for {self.target}"
        ]
        named = {
            what: getattr(self, what) for what in ("inputs", "parameters", "outputs", "slopes")
        }
        lines += [f"{what}: {', '.join(names)}" for what, names in named.items() if names]
        return "\n".join([*lines, *self.notes])


@answering
def export_fmu(
    mechanism: Mechanism,
    path: Any,
    *,
    integrator: AbstractIntegrator | None = None,
    inputs: Mapping[str, Any] | None = None,
    outputs: Mapping[str, Any] | None = None,
    parameters: Mapping[str, Any] | None = None,
    slopes: Sequence[str] = (),
    kinds: Sequence[str] = ("co-simulation",),
    duration: float = 1.0,
    interval: float = 1e-3,
    target: str | None = None,
    cpu: str | None = None,
) -> Fmu:
    """Export a mechanism as an FMI 3.0 unit (FMU) of machine code.

    The unit needs neither Python nor JAX. It is made by the C compiler of this machine or by the
    package ziglang (`pip install "jaxclear[fmu]"`). Its steps are those of `simulate`, saved at the
    communication points.

    Args:
        mechanism: the `Mechanism`, without surfaces that wear.
        path: path of the file, such as "crank.fmu".
        integrator: one of `jaxclear.integrator`; by default `Adaptive()`.
        inputs: numbers of loads that may change at any communication point, by name: a function
            of the mechanism, or its name in `mechanism.parameters()`, a dict; none by default.
        outputs: what is read, by name: (joint, "coordinate", "speed" or "transmitted"), a
            response, or a function of the run over the last communication step, a dict; by default
            coordinates and speeds of all joints that have some.
        parameters: numbers that may be set before a run begins, by name, as `inputs`, a dict; none
            by default.
        slopes: names of inputs and parameters along which derivatives of the outputs are carried.
        kinds: "co-simulation", "model exchange" or both.
        duration: length of a usual run [s], > 0.
        interval: usual communication step [s], > 0.
        target: system that the unit is for: "x86_64-linux", "aarch64-linux", "x86_64-windows",
            "x86_64-darwin" or "aarch64-darwin"; by default this one.
        cpu: name of the processor that the code is for: "x86-64", "x86-64-v2", "x86-64-v3" (2013
            and later, the default) or "x86-64-v4"; of ARM one that all have.

    Returns:
        What was exported, a `Fmu`.

    Raises:
        ValueError: if an argument is wrong, or the mechanism cannot be a unit.
        ImportError: if there is no C compiler.
    """
    check_double_precision()
    check_number("the duration", duration, "s", above=0)
    check_number("the interval", interval, "s", above=0)
    integrator = Adaptive() if integrator is None else integrator
    check_run(mechanism, integrator)
    kinds, slopes = ((x,) if isinstance(x, str) else tuple(x) for x in (kinds, slopes))
    for kind in kinds or ("",):
        check_name("kind", kind, KINDS, " of export_fmu")
    for name in wearing_in(mechanism):
        raise ValueError(WORN.format(name=name))
    for what, value in (("inputs", inputs), ("outputs", outputs), ("parameters", parameters)):
        expect({} if value is None else value, Mapping, f"{what} of export_fmu", "a dict")
        for name in value or {}:
            expect(name or None, str, f"a name in {what} of export_fmu", "a text")
    system, file = checked_target(target), Path(path)
    names = TARGETS[system]
    check_name("cpu", cpu or names.cpus[0], names.cpus, " of export_fmu")
    if file.suffix != ".fmu" or not file.parent.is_dir():
        raise ValueError(NO_PATH.format(path=file))
    command = find_compiler(system)
    mechanism, integrator = with_quantities((mechanism, integrator))
    times = np.linspace(0.0, duration, max(2, round(duration / interval) + 1))
    steps = load_steps(mechanism, integrator, times)
    unit = Unit(mechanism, steps.integrator, outputs, tuple(slopes), (duration, interval))
    unit.add_numbers(inputs or {}, parameters or {})
    made = io.BytesIO()
    header = unit.assemble("model exchange" in kinds)
    code = object_file(list(unit.made.values()), names.triple, cpu or names.cpus[0])
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", description(unit, file.stem, kinds))
        place = f"binaries/{system}/{IDENTIFIER}.{names.ending}"
        archive.writestr(place, link_library(command, header, code))
    file.write_bytes(made.getvalue())
    doubt = unit.functions.doubt
    notes = [*checked_by(steps.passed, Checks()).warnings, *([doubt] if doubt else [])]
    if system != this_machine():
        notes.append(f"It is for {system} and was not run here.")
    return Fmu(
        path=file,
        size=len(made.getvalue()),
        target=system,
        kinds=tuple(kinds),
        inputs=tuple(inputs or ()),
        parameters=tuple(parameters or ()),
        outputs=tuple(unit.units),
        slopes=tuple(slopes),
        notes=tuple(notes),
    )
