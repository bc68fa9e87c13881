"""A run as an animation in one file: `jaxclear.plot.animate`.

The scene in space is K3D's (three.js inside), whose page holds all its scripts; beside it the page
magnifies every joint with clearance. It opens without a server, and loads nothing from the network.

What is seen of the joints in the first view: which bodies lie between the eye and a joint with
clearance, and so are drawn as glass.
"""

import base64
import html
import importlib.util
import json
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import equinox as eqx
import matplotlib
import matplotlib.colors
import numpy as np

from jaxclear.components.beam import beam_of, whole_bodies
from jaxclear.components.body import GROUND, Marker
from jaxclear.components.load import Gravity
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_count, check_number, expect
from jaxclear.plot.animation.insets import Pushes, arrow, inset, pushes
from jaxclear.plot.canvas import check_run
from jaxclear.results.solids import (
    Part,
    Triangles,
    checked_meshes,
    join_parts,
    moves_in_plane,
    parts,
    size_of,
)
from jaxclear.results.trajectory import Trajectory

# Places of a joint and frames at which is looked; a body hides a joint where it covers more than
# this share of the places. A ray that ends on a surface does not cross it.
PLACES, SIGHTS, COVERED, ENDS = 8, 6, 0.25, 1e-3


def hiding(
    parts: Mapping[str, Part],
    moves: Mapping[str, np.ndarray],
    joints: Sequence[tuple[str, str]],
    eye: np.ndarray,
) -> set[str]:
    """Names of the parts whose solid hides one of the joints from the eye at some frame.

    Args:
        parts: solids by body.
        moves: pose of each body, shape (frames, 4, 4); of the ground (1, 4, 4).
        joints: (joint, body whose part of it is looked at).
        eye: position of the camera [m].
    """
    names: set[str] = set()
    frames = max(len(target) for target in moves.values())
    for frame in np.linspace(0, frames - 1, min(SIGHTS, frames)).astype(int):
        at = lambda name, points, frame=frame: _move(points, moves[name][frame % len(moves[name])])
        targets = [_front(at(body, parts[body].joints[name].points), eye) for name, body in joints]
        for name, part in parts.items():
            if name in names or not len(part.solid.points):
                continue
            triangles = at(name, part.solid.points)[part.solid.corners]
            if any(np.mean(_crossed(triangles, eye, target)) > COVERED for target in targets):
                names.add(name)
    return names


def _move(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def _front(points: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """Some of the points (n, 3) on the side of the eye."""
    near = np.argsort(np.linalg.norm(points - eye, axis=1))[: max(len(points) // 2, 1)]
    return points[near[np.linspace(0, len(near) - 1, min(PLACES, len(near))).astype(int)]]


def _crossed(triangles: np.ndarray, eye: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Which rays from the eye to the targets (n, 3) cross a triangle (m, 3, 3) on their way.

    Source: Moller & Trumbore 1997, J. Graphics Tools 2, 21, doi:10.1080/10867651.1997.10487468.
    """
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    from_corner = eye - triangles[:, 0]
    across = np.cross(from_corner, first)
    lengths = np.einsum("ti,ti->t", second, across)
    results = []
    for ray in targets - eye:
        normal = np.cross(ray, second)
        volume = np.einsum("ti,ti->t", first, normal)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.einsum("ti,ti->t", from_corner, normal) / volume
            v = (across @ ray) / volume
            share = lengths / volume
            inside = (u >= 0) & (v >= 0) & (u + v <= 1)
        results.append(np.any(inside & (share > 0) & (share < 1 - ENDS)))
    return np.array(results)


# A run is shown in so many seconds [s], unless it lasts about as long; frames at the most.
USUAL, SHORTEST, LONGEST, MOST_FRAMES = 10.0, 3.0, 60.0, 3000
GREY, RED = 0xB8BEC6, 0xC23B22
# How far the eye is away, in diagonals of what it is to see, and how wide it is open [deg].
AWAY, OPENING = 1.25, 40.0
# Frames at which it is asked what is to be seen.
LOOKS = 40
# How much of the light a body stops that is seen through.
GLASS = 0.25


class Animation(eqx.Module):
    """An animation of a run as one HTML page.

    A notebook shows it; `save` writes it to a file.

    Args:
        html: the page.
        frames: number of frames.
        lasts: duration as it is first shown [s].
    """

    html: str = eqx.field(static=True, repr=False)
    frames: int = eqx.field(static=True)
    lasts: float = eqx.field(static=True)

    def save(self, path: Any) -> Path:
        """Write the page to one file that opens by itself.

        Args:
            path: path of the file, ending in .html or .htm.

        Returns:
            The path.

        Raises:
            ValueError: if the path ends otherwise.
        """
        path = Path(path)
        if path.suffix.lower() not in (".html", ".htm"):
            raise ValueError(
                f'{path.name} ends in "{path.suffix}"; an animation is a page, and must end in '
                ".html."
            )
        path.write_text(self.html, encoding="utf-8")
        return path

    def _repr_html_(self) -> str:
        page = html.escape(self.html)
        style = "width: 100%; height: 640px; border: 1px solid #ddd"
        return f'<iframe srcdoc="{page}" style="{style}"></iframe>'


@answering
def animate(
    run: Trajectory,
    *,
    slower: float | None = None,
    fps: int = 60,
    meshes: Mapping[str, Any] | None = None,
    trace: Marker | Sequence[Marker] = (),
    title: str | None = None,
) -> Animation:
    """An animation of a run in space, with a magnified view of every joint with clearance.

    Arrows show the normal force of every contact on its journal; their length grows with the square
    root of the force. Each magnified view shows the journal in its bearing, the gap magnified, the
    contact forces and the worn depth at that time (also of a run that began worn). A body that
    hides a joint with clearance in the first view is transparent. Needs `pip install
    "jaxclear[view]"`.

    Args:
        run: the run.
        slower: seconds of animation for one second of the run [1], > 0; by default the run takes 10
            s, or as long as it is between 3 and 60 s.
        fps: frames per second, >= 1, taken from the nearest saving times; 60 by default.
        meshes: shape of bodies by name, in the body's frame: path of a file (as meshio reads it),
            or (points [m], triangles), or several of these by name, as `jaxclear.read_shapes`
            returns them. Other bodies are cuboids with their inertia, no larger than the distance
            of their joints.
        trace: a marker, or several, whose path is drawn as a line; none by default.
        title: text above the page; None (default) for none.

    Returns:
        The `Animation`.

    Raises:
        ValueError: if an argument is out of range or the run has a single saving time.
        ImportError: if k3d is not installed.
    """
    check_run(run)
    if slower is not None:
        check_number("slower of animate", slower, above=0)
    check_count("fps of animate", fps)
    trace = (trace,) if isinstance(trace, Marker) else trace
    expect(trace, (tuple, list), "trace of animate", "a list of markers")
    for marker in trace:
        expect(marker, Marker, "an entry of trace", "a jaxclear.Marker")
    solids = checked_meshes(run, meshes)
    if importlib.util.find_spec("k3d") is None:
        raise ImportError('an animation needs k3d: python -m pip install "jaxclear[view]".')
    last = _reached_times(run)
    duration = float(run.time[last - 1] - run.time[0])
    if last < 2 or duration <= 0:
        raise ValueError("the run has a single saved instant; save more of them to see it move.")
    if slower is None:
        slower = 1.0 if SHORTEST <= duration <= LONGEST else USUAL / duration
    moments = np.linspace(0, duration, min(int(duration * slower * fps) + 2, MOST_FRAMES))
    time = np.asarray(run.time)[:last] - float(run.time[0])
    frames = np.unique(np.searchsorted(time, moments - 1e-9 * duration).clip(0, last - 1))
    forces = pushes(run, frames, last, size_of(run))
    data = _data_for_script(run, frames, last, slower, title) | {"largest": forces.largest}
    page = _html_page(run, solids, frames, data, forces, [(m.body, run.marker(m)) for m in trace])
    return Animation(page, len(frames), duration * slower)


def _reached_times(run: Trajectory) -> int:
    """Saving times that the run reached."""
    finite = np.isfinite(np.asarray(run.states)).all(axis=1)
    inside = np.asarray(run.time) <= float(run.ended) * (1 + 1e-12)
    good = finite & inside
    return len(good) if good.all() else int(np.argmin(good))


def _data_for_script(
    run: Trajectory, frames: np.ndarray, last: int, slower: float, title: str | None
) -> dict[str, Any]:
    """What the page's own script needs."""
    joints = run.formulation.contact_joints(run.mechanism)
    colours = _choose_colours(run)
    return {
        "title": title or "",
        "slower": slower,
        "time": np.asarray(run.time)[frames],
        "bodies": [
            {"name": name, "colour": colours[name], "com": np.asarray(run.body(name).com)[frames]}
            for name in whole_bodies(run.mechanism.bodies)
        ],
        "ground": f"#{GREY:06x}",
        "joints": [inset(run, name, frames, last) for name in joints],
        "warnings": list(run.warnings),
    }


def _base64_array(values: Any) -> dict[str, Any]:
    """An array in base64: shares of 255 as bytes, everything else as single numbers."""
    if values.dtype == np.uint8:
        return {"shape": values.shape, "u8": base64.b64encode(values.tobytes()).decode()}
    array = np.ascontiguousarray(values, np.float32)
    return {"shape": array.shape, "f32": base64.b64encode(array.tobytes()).decode()}


def _choose_colours(run: Trajectory) -> dict[str, str]:
    palette = [matplotlib.colors.to_hex(f"C{k}") for k in range(10)]
    palette.pop(7)  # the grey of the ground
    bodies = run.mechanism.bodies
    names = whole_bodies(bodies)
    return {n: palette[names.index(beam_of(bodies, n)) % len(palette)] for n in bodies}


def _html_page(
    run: Trajectory, solids: dict, frames: np.ndarray, data: dict, forces: Pushes, traces: list
) -> str:
    """The page: K3D's own, with the script of the insets in it."""
    import k3d

    scene = k3d.plot(
        camera_auto_fit=False,
        grid_visible=False,
        menu_visibility=False,
        camera_fov=OPENING,
        background_color=0xFFFFFF,
        antialias=3,
        lighting=1.2,
    )
    size, colours = size_of(run), _choose_colours(run)
    time = np.asarray(run.time)[frames].tolist()
    bodies = {n: p for n, p in parts(run, solids, size).items() if len(p.triangles.points)}
    moves = {name: _body_matrices(run, name, frames) for name in bodies}
    scene.camera = _choose_camera(run, _extreme_points(bodies, moves))
    connections = run.mechanism.connections
    joints = [(one["name"], connections[one["name"]].child.body) for one in data["joints"]]
    joints = [(name, body) for name, body in joints if name in bodies[body].joints]
    glass = hiding(bodies, moves, joints, np.array(scene.camera[:3]))
    for name, part in bodies.items():
        colour = GREY if name == GROUND else int(colours[name][1:], 16)
        meshes = {name: (part.triangles, 1.0)}
        if name in glass:
            through = f"{name}, seen through"
            meshes = {name: (join_parts(part.joints.values()), 1.0), through: (part.solid, GLASS)}
        for called, (triangles, opacity) in meshes.items():
            if not len(triangles.points):
                continue
            mesh = _make_mesh(triangles, colour, called, opacity)
            if name != GROUND:
                mesh.model_matrix = {str(t): m for t, m in zip(time, moves[name], strict=True)}
            scene += mesh
    solid, data["arrows"] = arrow(), []
    for name, bodies in zip(forces.names, forces.matrices, strict=True):
        mesh = _make_mesh(solid, RED, f"force in {name}")
        mesh.model_matrix = {str(t): m for t, m in zip(time, bodies, strict=True)}
        data["arrows"].append(mesh.id)
        scene += mesh
    for name, motion in traces:
        path = np.asarray(motion.position, np.float32)[frames]
        colour = int(colours[name][1:], 16)
        scene += k3d.line(path, color=colour, width=0.004 * size, name=f"path on {name}")
    scene.snapshot_type = "full"
    script = resources.files("jaxclear.plot.animation").joinpath("viewer.js").read_text("utf-8")
    safe = json.dumps(data, default=_base64_array).replace("</", "<\\/")
    return scene.get_snapshot(9, additional_js_code=f"const RUN = {safe};\n{script}")


def _make_mesh(part: Triangles, colour: int, name: str, opacity: float = 1.0) -> Any:
    import k3d

    arrays = part.points.astype(np.float32), part.corners.astype(np.uint32)
    return k3d.mesh(*arrays, color=colour, name=name, side="double", opacity=opacity)


def _extreme_points(bodies: dict[str, Part], moves: dict[str, np.ndarray]) -> np.ndarray:
    """Places (n, 3) [m] as far as parts move."""
    places = []
    for name, part in bodies.items():
        some = moves[name][:: max(len(moves[name]) // LOOKS, 1)]
        ends = _box_corners(part.triangles.points)
        places.append(ends @ some[:, :3, :3].transpose(0, 2, 1) + some[:, None, :3, 3])
    return np.concatenate([one.reshape(-1, 3) for one in places])


def _box_corners(points: np.ndarray) -> np.ndarray:
    """Corners (8, 3) of the box around points."""
    low, high = points.min(axis=0), points.max(axis=0)
    return np.array([np.where([i & 1, i & 2, i & 4], high, low) for i in range(8)])


def _body_matrices(run: Trajectory, name: str, frames: np.ndarray) -> np.ndarray:
    """Where a body is, as matrices (frames, 4, 4); of the ground a single one."""
    if name == GROUND:
        return np.eye(4, dtype=np.float32)[None]
    motion = run.body(name)
    matrices = np.zeros((len(frames), 4, 4), np.float32)
    matrices[:, :3, :3] = np.asarray(motion.rotation)[frames]
    matrices[:, :3, 3] = np.asarray(motion.origin)[frames]
    matrices[:, 3, 3] = 1.0
    return matrices


def _choose_camera(run: Trajectory, places: np.ndarray) -> list[float]:
    """Eye, what it looks at, and what is up, to see places (n, 3): onto the plane of motion, or
    with gravity downwards."""
    low, high = places.min(axis=0), places.max(axis=0)
    middle, size = 0.5 * (low + high), float(np.linalg.norm(high - low))
    if moves_in_plane(run):
        up, towards = np.array([0.0, 1.0, 0.0]), np.array([-0.25, 0.25, 1.0])
    else:
        up = _up_direction(run)
        side = np.eye(3)[np.argmin(np.abs(up))]
        towards = side + 0.45 * np.cross(up, side) + 0.4 * up
    eye = middle + AWAY * size * towards / np.linalg.norm(towards)
    return [float(x) for x in (*eye, *middle, *up)]


def _up_direction(run: Trajectory) -> np.ndarray:
    """Against gravity; along z without any."""
    for load in run.mechanism.loads.values():
        if isinstance(load, Gravity):
            pull = np.zeros(3)
            pull[: len(load.acceleration)] = [float(x) for x in load.acceleration]
            if np.any(pull):
                return -pull / np.linalg.norm(pull)
    return np.array([0.0, 0.0, 1.0])
