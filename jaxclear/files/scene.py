"""A scene: a mechanism with how it is run, or at which positions it stands, and, where it says so,
what varies of it and which responses are wanted.

A scene as a file of YAML or JSON, data only:

```yaml
jaxclear_scene: 1
mechanism: {bodies: ..., connections: ..., loads: ..., guess: ...}
run: {duration: 0.5, integrator: FixedStep, save: 501}  # or {positions: {crank: [0, 0.1, 0.2]}}
variables: {clearance: {where: connections.B.joint.clearance, tolerance: 1.0e-5}}
responses: {peak: {kind: PeakContactForce, joint: B}}
drawing: {B: 20 H7/g6, pin: {kind: Position, diameter: 3.0e-5, marker: A.parent}}
```
"""

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxclear.files.forms import (
    AbstractForm,
    ByName,
    Choice,
    Flag,
    Integer,
    Listed,
    Number,
    NumberArray,
    Schema,
    Text,
)
from jaxclear.files.parts import Part, mapping_schema
from jaxclear.files.places import NumberPlaces, check_numbers
from jaxclear.files.text import JSON, YAML, Misread, Node, misread, parse_values, text_of
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_flags, check_name, expect
from jaxclear.ground.quantity import AbstractQuantified
from jaxclear.ground.wording import described, listed, unknown
from jaxclear.integrators import AbstractIntegrator
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.results.response import AbstractResponse, LargestError
from jaxclear.results.state_history import State
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.saving import Saving, as_saving
from jaxclear.simulation.simulate import check_duration, saving_times, simulate
from jaxclear.statics.position_path import checked_positions, positions
from jaxclear.statics.positions import Positions
from jaxclear.statics.resting_state import resting_state
from jaxclear.studies.position_problem import PositionProblem
from jaxclear.studies.problem import Problem
from jaxclear.studies.responses import by_name
from jaxclear.studies.tolerance import AbstractTolerance
from jaxclear.studies.tolerance.drawing import Drawing
from jaxclear.studies.variable import Condition, Variable

RESTING = "resting"


class Scene(AbstractQuantified):
    """A mechanism, how it is run, and what is to be computed: the content of a scene file.

    It describes either a run over time (`duration`) or positions without time (`positions`).
    `jaxclear.read_scene` and `jaxclear.write_scene` read and write it.

    Args:
        mechanism: the `Mechanism`.
        duration: duration of the run [s], > 0; None (default) for none.
        integrator: integrator of the run; None (default) for that of `simulate`.
        save: saving times of the run, as of `simulate`; None (default) for its default.
        state: initial state of the run, a `State`, or "resting" for that of
            `jaxclear.resting_state`; None (default) for the mechanism's own.
        variables: variables of the problem, by name; {} by default.
        responses: responses of the problem, by name; {} by default.
        correlation: correlation of the variables [1], as of `Problem`; None (default) for none.
        description: a text; "" by default.
        positions: coordinates of the drives [rad, m], by joint, as of `jaxclear.positions`; None
            (default) for none.
        reverse_loads: whether positions are computed under reversed loads too; False by default.
        drawing: lines of the mechanism's drawing, by name, as of a `Drawing`; {} by default.
        general: general tolerance of the drawing, as of a `Drawing`; None (default) for none.

    Raises:
        ValueError: if an argument is out of range, or a run and positions are given together.
    """

    mechanism: Mechanism
    duration: Any = None
    integrator: AbstractIntegrator | None = None
    save: Any = None
    state: State | str | None = None
    variables: Any = eqx.field(default_factory=dict)
    responses: Any = eqx.field(default_factory=dict)
    correlation: Any = None
    description: str = ""
    positions: Any = None
    reverse_loads: bool = False
    drawing: Any = eqx.field(default_factory=dict)
    general: str | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        check_flags("Scene", reverse_loads=self.reverse_loads)
        if self.positions is not None:
            checked_positions(self.positions)
            timed = ("duration", "integrator", "save", "state")
            extra = [name for name in timed if getattr(self, name) is not None]
            if extra:
                raise ValueError(
                    f"a Scene is given positions and {listed(extra)}; it is a mechanism over "
                    "positions, without time, or a run: give one of the two."
                )
        elif self.reverse_loads:
            raise ValueError(
                "a Scene is given reverse_loads without positions, to which it belongs."
            )
        if self.duration is not None:
            check_duration(self.duration)
        if isinstance(self.state, str):
            check_name("start of a Scene, beside a jaxclear.State", self.state, [RESTING])
        by_name("variables", self.variables)
        expect(self.responses, Mapping, "responses of a Scene", "a dictionary from names")

    def _summary(self):
        """What it is of, how it is run, and what is asked of it."""
        m = self.mechanism
        lines = [f"Scene{f': {self.description}' if self.description else ''}"]
        for part in ("bodies", "connections", "loads", "couplings"):
            lines += [f"  {part} {', '.join(getattr(m, part))}"] if getattr(m, part) else []
        settings = {
            "duration": None if self.duration is None else f"{float(self.duration):.6g} s",
            "positions of": self.positions and ", ".join(self.positions),
            "integrator": self.integrator,
            "state": self.state,
            "variables": ", ".join(self.variables),
            "responses": ", ".join(self.responses),
            "drawing": ", ".join(self.drawing),
        }
        return "\n".join([*lines, *(f"  {what} {v}" for what, v in settings.items() if v)])

    def simulate(
        self,
        *,
        balance: bool = False,
        progress_bar: bool = False,
        throw: bool = True,
        verify: bool | None = None,
    ) -> Trajectory:
        """Run the scene.

        Args:
            balance: whether to track energies, as of `jaxclear.simulate`; False by default.
            progress_bar: whether to show the progress; False by default.
            throw: whether a run that fails raises an error; True by default.
            verify: whether to estimate numerical errors by companion runs, as of
                `jaxclear.simulate`; None by default.

        Returns:
            The `Trajectory`.

        Raises:
            ValueError: if the scene has positions or no duration.
        """
        if self.positions is not None:
            raise ValueError(
                "this scene states positions, without time: ask scene.stand(), or give it a "
                "duration [s] in their place."
            )
        arguments = self._run_arguments()
        flags: dict[str, Any] = {"balance": balance, "progress_bar": progress_bar, "throw": throw}
        flags["verify"] = verify
        return simulate(self.mechanism, integrator=self.integrator, **arguments, **flags)

    def stand(self) -> Positions:
        """The mechanism at the positions of the scene, as `jaxclear.positions` computes it.

        Returns:
            The `Positions`.

        Raises:
            ValueError: if the scene has no positions.
        """
        if self.positions is None:
            raise ValueError("this scene states no positions; give it some, or ask for its run.")
        return positions(self.mechanism, self.positions, reverse_loads=self.reverse_loads)

    def problem(self) -> Problem:
        """The problem of the scene, for studies.

        Returns:
            A `Problem` of a run, or of positions.

        Raises:
            ValueError: if the scene has no variables or no responses.
        """
        drawn = self.drawn()
        varied = drawn.variables | dict(self.variables)
        for what, entries in (("variables", varied), ("responses", self.responses)):
            if not entries:
                raise ValueError(f"this scene states no {what}; a problem needs some.")
        parts = (drawn.mechanism, self._responses_with_reference(), varied)
        more: dict[str, Any] = {"correlation": self.correlation}
        if self.positions is not None:
            more |= {"positions": self.positions, "reverse_loads": self.reverse_loads}
            return PositionProblem(*parts, **more)
        more |= {"integrator": self.integrator, **self._run_arguments()}
        return Problem(*parts, **more)

    def drawn(self) -> Drawing:
        """The mechanism as its drawing tolerances it.

        Returns:
            The `Drawing`, of no lines where the scene states none.
        """
        return Drawing(self.mechanism, dict(self.drawing), general=self.general)

    def at_rest(self, count: int = 13) -> "Scene":
        """The same scene at positions of its drives over the run, without time.

        Args:
            count: number of positions, >= 2; 13 by default.

        Returns:
            The `Scene`.

        Raises:
            ValueError: if nothing is driven.
        """
        positions = self._driven(np.linspace(0.0, float(self._run_arguments()["duration"]), count))
        changed: Any = dict.fromkeys(("duration", "integrator", "save", "state"))
        return dataclasses.replace(self, **changed | {"positions": positions})

    def _driven(self, times: Any) -> dict[str, Any]:
        """Coordinates of the drives at some times [s]."""
        joints = {n: self.mechanism.connections[n].joint for n in self.mechanism.driven}
        if not joints:
            raise ValueError("nothing drives this mechanism; give a joint a drive.")
        at = lambda joint: [float(joint.drive.motion(jnp.asarray(t))[0]) for t in times]
        return {name: at(joint) for name, joint in joints.items()}

    def _responses_with_reference(self) -> dict[str, Any]:
        """The responses, with the mechanism without clearance where one has no reference."""
        found = dict(self.responses)
        bare = lambda own: isinstance(own, LargestError) and own.reference is None
        if not any(map(bare, found.values())):
            return found
        ideal, driven = self.mechanism, self.positions
        if driven is None:
            arguments = self._run_arguments()
            driven = self._driven(saving_times(arguments["duration"], arguments.get("save", 201)))
        for name in ideal.topology.clearances:
            ideal = ideal.with_joint(name, ideal.connections[name].joint.coordinate_form())
        there = positions(ideal, driven)
        for name, own in found.items():
            if bare(own):
                found[name] = dataclasses.replace(own, reference=own.values(there))
        return found

    def _run_arguments(self) -> dict[str, Any]:
        """What `simulate` and `Problem` are given alike."""
        if self.duration is None:
            raise ValueError(
                "this scene states no duration and no positions: give jaxclear.Scene(mechanism, "
                "duration=...) one [s], or run jaxclear.simulate(scene.mechanism, duration)."
            )
        state = resting_state(self.mechanism) if isinstance(self.state, str) else self.state
        arguments: dict[str, Any] = {"duration": self.duration, "state": state}
        return arguments if self.save is None else arguments | {"save": self.save}


FORMAT = 1
HEAD = "jaxclear_scene"
DRAFT = "https://json-schema.org/draft/2020-12/schema"


@dataclass(frozen=True)
class Correlated:
    """Correlation of two variables in a scene file.

    Args:
        between: names of both variables.
        coefficient: correlation of their normal scores [1].
    """

    between: tuple[str, str]
    coefficient: float


PAIRS = Listed(Part((Correlated,)))
# What stands at the top of a file, and under "run".
TOP: dict[str, AbstractForm] = {
    HEAD: Integer({"at_least": 1}),
    "$schema": Text(),
    "written_by": Text(),
    "description": Text(),
    "drawing": ByName(Choice((Text(), Part((AbstractTolerance,), spelled_out=True)))),
    "general": Text(),
    "mechanism": Part((Mechanism,)),
    "variables": ByName(Part((Variable, Condition))),
    "responses": ByName(Part((AbstractResponse,))),
    "correlation": Choice((PAIRS, NumberArray())),
}
RUN: dict[str, AbstractForm] = {
    "duration": Number({"unit": "s", "above": 0}),
    "integrator": Part((AbstractIntegrator,)),
    "save": Choice((Integer({"at_least": 2}), NumberArray(), Part((Saving,)))),
    "state": Choice((Text(), Part((State,)))),
    "positions": ByName(NumberArray()),
    "reverse_loads": Flag(),
}


@answering
def read_scene(path: Any) -> Scene:
    """Read a scene from a file of YAML or JSON.

    A file holds data in SI units, never code: nothing in it is executed or imported, and it names
    only classes that are already loaded. Paths in it (tables as CSV) are relative to its folder.
    `jaxclear.scene_schema()` is its JSON schema.

    Args:
        path: path of the file, ending in .yaml, .yml or .json.

    Returns:
        The `Scene`.

    Raises:
        ValueError: if the file is invalid, with line and place.
    """
    path = _as_path(path)
    try:
        return _read_scene(parse_values(text_of(path), path.suffix), path.parent)
    except Misread as error:
        raise Misread(f"{path.name}: {error}") from None


@answering
def write_scene(scene: Scene | Mechanism, path: Any) -> None:
    """Write a scene to a file of YAML or JSON, every number with all digits.

    Args:
        scene: a `Scene`, or a `Mechanism` alone.
        path: path of the file, ending in .yaml, .yml or .json.

    Raises:
        ValueError: if the path ends otherwise, or the scene holds code (a function of the user) or
            a traced number; no file is written then.
    """
    path = _as_path(path)
    scene = Scene(scene) if isinstance(scene, Mechanism) else scene
    expect(scene, Scene, "what is written", "a jaxclear.Scene or a jaxclear.Mechanism")
    ending = path.suffix.lower()
    if ending not in (*YAML, *JSON):
        raise ValueError(f'{path.name} ends in "{ending}"; it must end in .yaml, .yml or .json.')
    path.write_text(scene_text(scene, ending), encoding="utf-8")


def scene_text(scene: Scene, ending: str = ".yaml") -> str:
    """The text of a scene's file.

    Args:
        scene: the `Scene`.
        ending: ".yaml" (default), ".yml" or ".json".

    Returns:
        The text.
    """
    values = _plain_values(scene)
    if ending in JSON:
        return json.dumps(values, indent=1, ensure_ascii=False) + "\n"
    import yaml

    class Plain(yaml.SafeDumper):
        def ignore_aliases(self, data: Any) -> bool:
            return True

    style: dict[str, Any] = {"sort_keys": False, "default_flow_style": None, "width": 100}
    return yaml.dump(values, Dumper=Plain, allow_unicode=True, **style)


def _as_path(path: Any) -> Path:
    if not isinstance(path, (str, Path)) or not str(path):
        raise ValueError(f"the file is {described(path)}; it must be a path.")
    return Path(path)


def _read_scene(node: Node, folder: Path) -> Scene:
    values = _read_mapping(node, "the file", {*TOP, "run"})
    if HEAD not in values:
        raise Misread(f'has no "{HEAD}: {FORMAT}"; a scene file begins with it.')
    if values[HEAD].value != FORMAT or isinstance(values[HEAD].value, bool):
        sentence = f"is {values[HEAD].words}; this version of jaxclear reads {FORMAT}."
        raise misread(values[HEAD], HEAD, sentence)
    if "mechanism" not in values:
        raise Misread("has no mechanism.")
    read = {
        name: form.read(values[name], name, folder)
        for name, form in TOP.items()
        if name in values and values[name].value is not None and name != "correlation"
    }
    expect(read.get("mechanism"), Mechanism, "mechanism", "a mapping of bodies and connections")
    run = _read_mapping(values["run"], "run", RUN) if "run" in values else {}
    for name, entry in run.items():
        if entry.value is not None:
            read[name] = RUN[name].read(entry, f"run.{name}", folder)
    if "correlation" in values:
        read["correlation"] = _read_correlation(values["correlation"], folder)
    for name, variable in read.get("variables", {}).items():
        _check_variable(variable, read["mechanism"], values["variables"].value[name], name)
    for name, response in read.get("responses", {}).items():
        _check_response(response, read["mechanism"], values["responses"].value[name], name)
    for word in (HEAD, "$schema", "written_by"):
        read.pop(word, None)
    try:
        return Scene(**read)
    except ValueError as error:
        raise Misread(f"run: {error}") from None


def _read_mapping(node: Node, what: str, names: Any) -> dict[str, Node]:
    """The values of a mapping whose names are known."""
    if not isinstance(node.value, dict):
        raise misread(node, what, f"is {node.words}; it must be a mapping of {listed(names)}.")
    for name, entry in node.value.items():
        if name not in names:
            raise misread(entry, what, unknown("entry", name, names))
    return node.value


def _read_correlation(node: Node, folder: Path) -> Any:
    """Coefficients by pairs, or a matrix."""
    pairs = isinstance(node.value, list) and node.value and isinstance(node.value[0].value, dict)
    if not pairs:
        return NumberArray().read(node, "correlation", folder)
    entries = PAIRS.read(node, "correlation", folder)
    return {entry.between: entry.coefficient for entry in entries}


def _check_variable(variable: Any, mechanism: Mechanism, node: Node, name: str) -> None:
    """That a variable points at numbers of the mechanism."""
    path = f'variables["{name}"]'
    try:
        where = getattr(variable, "where", None)
        if isinstance(where, NumberPlaces):
            check_numbers(where, mechanism)
        variable.check(name, mechanism)
    except ValueError as error:
        raise misread(node, path, str(error)) from None


def _check_response(response: Any, mechanism: Mechanism, node: Node, name: str) -> None:
    """That a response asks about a joint and a body that there are."""
    parts: dict[str, Mapping[str, Any]] = {"joint": mechanism.connections, "body": mechanism.bodies}
    for what, names in parts.items():
        name_of = getattr(response, what, None)
        if isinstance(name_of, str) and name_of not in names:
            sentence = unknown(what, name_of, names, " in this mechanism")
            raise misread(node, f'responses["{name}"]', sentence)


def _plain_values(scene: Scene) -> dict[str, Any]:
    """A scene in plain values."""
    mechanism = scene.mechanism
    plain_scene: dict[str, Any] = {HEAD: FORMAT, "written_by": _program_version()}
    if scene.description:
        plain_scene["description"] = scene.description
    plain = lambda form, thing, path: form.plain(thing, path, mechanism)
    plain_scene["mechanism"] = plain(TOP["mechanism"], mechanism, "")
    settings = {
        "duration": scene.duration,
        "integrator": scene.integrator,
        "save": _plain_save(scene.save),
        "state": scene.state,
        "positions": scene.positions,
        "reverse_loads": scene.reverse_loads or None,
    }
    run = {name: plain(RUN[name], v, name) for name, v in settings.items() if v is not None}
    plain_scene |= {"run": run} if run else {}
    for what in ("variables", "responses", "drawing"):
        v = dict(getattr(scene, what))
        plain_scene |= {what: plain(TOP[what], v, what)} if v else {}
    plain_scene |= {"general": scene.general} if scene.general else {}
    if scene.correlation is not None:
        plain_scene["correlation"] = _plain_correlation(scene.correlation, mechanism)
    return plain_scene


def _plain_save(save: Any) -> Any:
    """Saving times or their number as a file tells them; a `Saving` where it keeps events too."""
    if save is None or as_saving(save).events:
        return save
    at = as_saving(save).at
    return int(at) if np.ndim(at) == 0 else np.asarray(at, float)


def _plain_correlation(correlation: Any, mechanism: Mechanism) -> Any:
    if isinstance(correlation, dict):
        entries = tuple(Correlated(tuple(pair), value) for pair, value in correlation.items())
        return PAIRS.plain(entries, "correlation", mechanism)
    return NumberArray().plain(correlation, "correlation", mechanism)


def _program_version() -> str:
    try:
        return f"jaxclear {version('jaxclear')}"
    except PackageNotFoundError:
        return "jaxclear"


def scene_schema() -> Schema:
    """The JSON schema (draft 2020-12) of scene files.

    It gives kinds, names, units and ranges. Classes of the user are not in it, and relations
    between numbers are checked only when a file is read.

    Returns:
        The schema as a dictionary.
    """
    defs: dict[str, Schema] = {}
    of = lambda forms: {name: form.schema(defs) for name, form in forms.items()}
    properties = of(TOP) | {HEAD: {"const": FORMAT}, "run": mapping_schema(of(RUN), [])}
    return {
        "$schema": DRAFT,
        "title": "A scene of jaxclear",
        "description": "A mechanism, how it is run, what varies of it, and responses; SI units.",
        **mapping_schema(properties, [HEAD, "mechanism"]),
        "$defs": dict(sorted(defs.items())),
    }
