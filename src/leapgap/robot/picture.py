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

from leapgap.robot.model import Robot

BACKENDS = ("egl", "osmesa")
"""Libraries that draw without a screen; the environment's ``MUJOCO_GL`` stands before them."""
SIZE, SECONDS = (480, 360), 60
"""Width and height, pixels, and time for the picture."""
COLOUR, OTHERS = (0.89, 0.33, 0.18, 1.0), (0.62, 0.65, 0.70, 1.0)
AZIMUTH, ELEVATION, DISTANCE = 130.0, -20.0, 1.6


def robot_picture(robot: Robot, joints: Sequence[str]) -> bytes | None:
    """PNG of the robot in its first pose with the links that some joints move coloured; None where none can be drawn.

    Where nothing of the robot is, the picture is transparent.
    """
    asked = json.dumps({"path": str(robot.path.resolve()), "fix_base": robot.fix_base, "joints": list(joints)})
    for backend in dict.fromkeys((os.environ.get("MUJOCO_GL", ""), *BACKENDS)):
        if backend not in BACKENDS:
            continue
        try:
            run = subprocess.run(
                [sys.executable, "-m", __name__, asked],
                env={**os.environ, "MUJOCO_GL": backend},
                capture_output=True,
                timeout=SECONDS,
            )
        except (OSError, subprocess.TimeoutExpired):
            return None
        if run.returncode == 0 and run.stdout.startswith(b"\x89PNG"):
            return run.stdout
    return None


def draw(robot: Robot, joints: Sequence[str]) -> np.ndarray:
    """Pixels of the picture, red, green, blue and opacity, (height, width, 4)."""
    model = robot.published_spec().compile()
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
    own = [geom for geom in range(model.ngeom) if model.geom_bodyid[geom]]
    places, sizes = data.geom_xpos[own], model.geom_rbound[own][:, None]
    low, high = (places - sizes).min(axis=0), (places + sizes).max(axis=0)
    camera = mujoco.MjvCamera()
    camera.lookat[:], camera.distance = (low + high) / 2, DISTANCE * float(np.linalg.norm(high - low))
    camera.azimuth, camera.elevation = AZIMUTH, ELEVATION
    with mujoco.Renderer(model, SIZE[1], SIZE[0]) as renderer:
        renderer.update_scene(data, camera)
        colours = renderer.render().copy()
        renderer.enable_segmentation_rendering()
        renderer.update_scene(data, camera)
        shown = renderer.render()[..., 0] >= 0
    return np.dstack([colours, np.where(shown, 255, 0).astype(np.uint8)])


def png(pixels: np.ndarray) -> bytes:
    """Pixels (height, width, 4) as PNG."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    height, width, _ = pixels.shape
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)
    head = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b"")


def main() -> None:
    """Write the picture that the argument asks for to standard output."""
    asked = json.loads(sys.argv[1])
    robot = Robot.load(Path(asked["path"]), fix_base=asked["fix_base"])
    sys.stdout.buffer.write(png(draw(robot, asked["joints"])))


if __name__ == "__main__":
    main()
