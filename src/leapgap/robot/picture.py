"""Pictures of a robot by MuJoCo without a screen, where the machine can draw: its links, and loops of its motion.

They are drawn in a process of its own: a graphics library that fails may end it.
"""

import io
import json
import os
import struct
import subprocess
import sys
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from leapgap.robot.kinematics import SHOWN_GROUPS
from leapgap.robot.model import Robot

BACKENDS = ("egl", "osmesa")  # libraries that draw without a screen; the environment's ``MUJOCO_GL`` stands before them
SIZE, SECONDS = (480, 360), 60  # width and height, pixels, and time for the picture
COLOUR, OTHERS = (0.89, 0.33, 0.18, 1.0), (0.62, 0.65, 0.70, 1.0)
AZIMUTH, ELEVATION, DISTANCE = 130.0, -20.0, 1.35
ROD = 0.03  # radius of rods in place of shapes, as a share of the distance between the outermost links
HALF = 0.6  # share of the sphere about a shape that is sure to be seen
SIGNATURE = b"\x89PNG\r\n\x1a\n"


def robot_picture(robot: Robot, joints: Sequence[str]) -> bytes | None:
    """PNG of the robot in its first pose with the links that some joints move coloured; None where none can be drawn.

    Where nothing of the robot is, the picture is transparent.
    """
    return drawn(robot, joints=np.array(list(joints), dtype=str))


def drawn(robot: Robot, **asked: Any) -> bytes | None:
    """The PNG of a robot that ``main`` draws in a process of its own for some arrays; None where it cannot."""
    buffer = io.BytesIO()
    np.savez(buffer, robot=json.dumps([str(robot.path.resolve()), robot.fix_base]), **asked)
    for backend in dict.fromkeys((os.environ.get("MUJOCO_GL", ""), *BACKENDS)):
        if backend not in BACKENDS:
            continue
        try:
            run = subprocess.run(
                [sys.executable, "-m", __name__],
                env={**os.environ, "MUJOCO_GL": backend},
                capture_output=True,
                input=buffer.getvalue(),
                timeout=SECONDS,
            )
        except (OSError, subprocess.TimeoutExpired):
            return None
        if run.returncode == 0 and run.stdout.startswith(SIGNATURE):
            return run.stdout
    return None


def draw(robot: Robot, joints: Sequence[str]) -> np.ndarray:
    """Pixels of the picture, red, green, blue and opacity, (height, width, 4)."""
    model = shown_model(robot)
    moved = {int(model.joint(joint).bodyid[0]) for joint in joints}
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        model.geom_matid[geom] = -1
        model.geom_rgba[geom] = COLOUR if body in moved else OTHERS
        if model.geom_type[geom] == int(mujoco.mjtGeom.mjGEOM_PLANE):
            model.geom_rgba[geom, 3] = 0.0
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    light(model)
    camera = framing(model, data.qpos[None])
    with mujoco.Renderer(model, SIZE[1], SIZE[0]) as renderer:
        renderer.update_scene(data, camera)
        colours = renderer.render().copy()
        renderer.enable_segmentation_rendering()
        renderer.update_scene(data, camera)
        shown = renderer.render()[..., 0] >= 0
    return np.dstack([colours, np.where(shown, 255, 0).astype(np.uint8)])


def shown_model(robot: Robot) -> mujoco.MjModel:
    """The robot as it is drawn: a link without visible shapes by its contacts' ones; rods where shapes are few."""
    spec = robot.published_spec()
    links = [body for body in spec.bodies if body.name != "world"]
    shapes = [geom for body in links for geom in body.geoms]
    for body in links:
        if all(geom.group >= SHOWN_GROUPS for geom in body.geoms):
            for geom in body.geoms:
                geom.group = 0
    if len(shapes) < len(links):
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        thickness = ROD * float(np.linalg.norm(np.ptp(data.xpos[1:], axis=0))) or ROD
        for body in links:
            ends = [part.pos for part in (*body.bodies, *body.geoms) if np.linalg.norm(part.pos) > thickness]
            for end in ends or [2 * body.ipos]:
                about = {"fromto": [0, 0, 0, *end]} if np.linalg.norm(end) > thickness else {}
                kind = mujoco.mjtGeom.mjGEOM_CAPSULE if about else mujoco.mjtGeom.mjGEOM_SPHERE
                body.add_geom(type=kind, size=[thickness, 0, 0], mass=0, contype=0, conaffinity=0, group=0, **about)
    return spec.compile()


def light(model: mujoco.MjModel) -> None:
    """Light from everywhere, so that colours are what they are on light and dark pages."""
    light = model.vis.headlight
    light.ambient[:], light.diffuse[:], light.specular[:] = 0.55, 0.5, 0.1
    model.light_active[:] = 0


def framing(model: mujoco.MjModel, course: np.ndarray) -> mujoco.MjvCamera:
    """A camera that sees the robot throughout a course of positions (frames, nq)."""
    own, data = np.flatnonzero(model.geom_bodyid > 0), mujoco.MjData(model)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for qpos in course[::3]:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        half = HALF * model.geom_rbound[own, None]
        low = np.minimum(low, (data.geom_xpos[own] - half).min(axis=0))
        high = np.maximum(high, (data.geom_xpos[own] + half).max(axis=0))
    camera = mujoco.MjvCamera()
    camera.lookat[:], camera.distance = (low + high) / 2, DISTANCE * float(np.linalg.norm(high - low))
    camera.azimuth, camera.elevation = AZIMUTH, ELEVATION
    return camera


def chunk(kind: bytes, content: bytes) -> bytes:
    """A part of a PNG."""
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def header(width: int, height: int) -> bytes:
    """Signature and first part of a PNG with red, green, blue and opacity of eight bits."""
    return SIGNATURE + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0))


def compressed(pixels: np.ndarray) -> bytes:
    """Pixels (height, width, 4) as a PNG holds them."""
    return zlib.compress(b"".join(b"\0" + row.tobytes() for row in pixels), 9)


def png(pixels: np.ndarray) -> bytes:
    """Pixels (height, width, 4) as PNG."""
    height, width, _ = pixels.shape
    return header(width, height) + chunk(b"IDAT", compressed(pixels)) + chunk(b"IEND", b"")


LOOP_SIZE = (360, 270)  # width and height, pixels
LENGTH_S, PER_S = 6.0, 8  # length of a loop and its frames a second
SLOWEST = 5.0  # short motions are shown this many times slower at most
COLOURS = ((0.62, 0.65, 0.70, 1.0), (0.89, 0.33, 0.18, 1.0), (0.15, 0.39, 0.79, 1.0))
"""Of what was measured, of the nominal and of the corrected replay."""
LAYERS = {2: (1, 0), 3: (1, 2, 0)}  # order in which layers are drawn: nominal, corrected, measured above both
LEVELS = 32  # colours are rounded to this many levels, which makes a loop a third as large


@dataclass(frozen=True)
class Loop:
    """A loop that was drawn."""

    png: bytes
    begin_s: float
    end_s: float  # stretch of the log that it shows
    slower: float  # how many times slower than the robot it is


def robot_loop(robot: Robot, time: np.ndarray, layers: Sequence[np.ndarray]) -> Loop | None:
    """A loop of positions ``layers``, (rows, nq) each: measured, nominal, corrected; None where none can be drawn.

    The first seconds of a long log are shown.
    """
    rows = min(len(time), *map(len, layers))
    shown = np.flatnonzero(time[:rows] - time[0] <= LENGTH_S)
    length = float(time[shown[-1]] - time[0])
    if length <= 0 or not all(np.isfinite(layer[shown]).all() for layer in layers):
        return None
    slower = float(np.clip(LENGTH_S / length, 1.0, SLOWEST))
    at = np.searchsorted(time[shown], time[0] + np.arange(0, length, 1 / (PER_S * slower)))
    found = drawn(robot, layers=np.stack([layer[at] for layer in layers]))
    return None if found is None else Loop(found, float(time[0]), float(time[shown[-1]]), slower)


def frames(robot: Robot, layers: np.ndarray) -> Iterator[np.ndarray]:
    """Pixels (height, width, 4) of each frame of positions (layers, frames, nq); all else is transparent."""
    model = shown_model(robot)
    planes = model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)
    model.geom_matid[:] = -1
    light(model)
    model.vis.quality.offsamples = 0  # edges would be blended with black
    data, camera = mujoco.MjData(model), framing(model, layers[0])
    with mujoco.Renderer(model, LOOP_SIZE[1], LOOP_SIZE[0]) as renderer:
        for frame in range(layers.shape[1]):
            seen = np.zeros((LOOP_SIZE[1], LOOP_SIZE[0], 4), np.uint8)
            for layer in LAYERS[len(layers)]:
                data.qpos[:] = layers[layer, frame]
                mujoco.mj_forward(model, data)
                model.geom_rgba[:] = COLOURS[layer]
                model.geom_rgba[planes, 3] = 0.0
                renderer.update_scene(data, camera)
                for flag in ("SHADOW", "REFLECTION", "SKYBOX", "HAZE"):
                    renderer.scene.flags[getattr(mujoco.mjtRndFlag, f"mjRND_{flag}")] = 0
                colours = renderer.render()
                rounded = np.round(colours * ((LEVELS - 1) / 255)) * (255 // (LEVELS - 1))
                drawn_here = colours.any(axis=2)
                seen[drawn_here, :3], seen[drawn_here, 3] = rounded[drawn_here], 255
            yield seen


def animated(pictures: Iterator[np.ndarray], count: int) -> bytes:
    """Pictures of one size as an animated PNG that repeats; of each only the part that differs from the one before."""
    parts, sequence = [header(*LOOP_SIZE), chunk(b"acTL", struct.pack(">II", count, 0))], 0
    before: np.ndarray | None = None
    for picture in pictures:
        top, left, part = changed_part(picture, before)
        size = struct.pack(">IIII", part.shape[1], part.shape[0], left, top)
        parts.append(chunk(b"fcTL", struct.pack(">I", sequence) + size + struct.pack(">HHBB", 1, PER_S, 0, 0)))
        content = compressed(part)
        kind, lead = (b"IDAT", b"") if before is None else (b"fdAT", struct.pack(">I", sequence + 1))
        parts.append(chunk(kind, lead + content))
        sequence += 1 if before is None else 2
        before = picture
    return b"".join([*parts, chunk(b"IEND", b"")])


def changed_part(picture: np.ndarray, before: np.ndarray | None) -> tuple[int, int, np.ndarray]:
    """First row and column of the smallest part of a picture that differs from the one before, and that part."""
    if before is None:
        return 0, 0, picture
    rows, columns = (np.flatnonzero((picture != before).any(axis=axes)) for axes in ((1, 2), (0, 2)))
    if not len(rows):
        return 0, 0, picture[:1, :1]
    return int(rows[0]), int(columns[0]), picture[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def main() -> None:
    """Write the picture or the loop that standard input asks for to standard output."""
    asked = np.load(io.BytesIO(sys.stdin.buffer.read()))
    path, fix_base = json.loads(str(asked["robot"]))
    robot = Robot.load(Path(path), fix_base=fix_base)
    if "layers" in asked:
        found = animated(frames(robot, asked["layers"]), asked["layers"].shape[1])
    else:
        found = png(draw(robot, asked["joints"].tolist()))
    sys.stdout.buffer.write(found)


if __name__ == "__main__":
    main()
