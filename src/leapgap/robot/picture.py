"""A picture of a robot with some of its links coloured, by MuJoCo without a screen, where the machine can draw one.

It is drawn in a process of its own: a graphics library that fails may end it.
"""

import json
import os
import struct
import subprocess
import sys
import zlib
from collections.abc import Sequence
from pathlib import Path

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
    asked = {"path": str(robot.path.resolve()), "fix_base": robot.fix_base, "joints": list(joints)}
    return drawn(__name__, json.dumps(asked).encode())


def drawn(module: str, asked: bytes) -> bytes | None:
    """The PNG that a module writes to standard output for what is asked on standard input; None where it cannot."""
    for backend in dict.fromkeys((os.environ.get("MUJOCO_GL", ""), *BACKENDS)):
        if backend not in BACKENDS:
            continue
        try:
            run = subprocess.run(
                [sys.executable, "-m", module],
                env={**os.environ, "MUJOCO_GL": backend},
                capture_output=True,
                input=asked,
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


def main() -> None:
    """Write the picture that standard input asks for to standard output."""
    asked = json.loads(sys.stdin.buffer.read())
    robot = Robot.load(Path(asked["path"]), fix_base=asked["fix_base"])
    sys.stdout.buffer.write(png(draw(robot, asked["joints"])))


if __name__ == "__main__":
    main()
