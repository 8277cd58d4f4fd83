"""A loop of a robot's motion with its replays behind it, as animated PNG, drawn by MuJoCo in a process of its own."""

import io
import struct
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from leapgap.robot.model import Robot
from leapgap.robot.picture import chunk, compressed, drawn, framing, header, light, shown_model

SIZE = (360, 270)  # width and height, pixels
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
    buffer = io.BytesIO()
    path = np.array(str(robot.path.resolve()))
    np.savez(buffer, path=path, fixed=[robot.fix_base is True], layers=np.stack([layer[at] for layer in layers]))
    found = drawn(__name__, buffer.getvalue())
    return None if found is None else Loop(found, float(time[0]), float(time[shown[-1]]), slower)


def frames(robot: Robot, layers: np.ndarray) -> Iterator[np.ndarray]:
    """Pixels (height, width, 4) of each frame of positions (layers, frames, nq); all else is transparent."""
    model = shown_model(robot)
    planes = model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)
    model.geom_matid[:] = -1
    light(model)
    model.vis.quality.offsamples = 0  # edges would be blended with black
    data, camera = mujoco.MjData(model), framing(model, layers[0])
    with mujoco.Renderer(model, SIZE[1], SIZE[0]) as renderer:
        for frame in range(layers.shape[1]):
            seen = np.zeros((SIZE[1], SIZE[0], 4), np.uint8)
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
    parts, sequence = [header(*SIZE), chunk(b"acTL", struct.pack(">II", count, 0))], 0
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
    """Write the loop that standard input asks for to standard output."""
    asked = np.load(io.BytesIO(sys.stdin.buffer.read()))
    robot = Robot.load(Path(str(asked["path"])), fix_base=True if asked["fixed"][0] else None)
    layers = asked["layers"]
    sys.stdout.buffer.write(animated(frames(robot, layers), layers.shape[1]))


if __name__ == "__main__":
    main()
