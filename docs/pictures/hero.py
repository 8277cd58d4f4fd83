"""The moving picture of the front page: a jump as measured, by the nominal and by the corrected simulation.

    MUJOCO_GL=egl python docs/pictures/hero.py docs/pictures/hero.png

The measured robot is a simulated A1 with hidden effects (``HARDWARE``), whose logs are diagnosed here. Both
simulations replay the commands of a jump that the diagnosis did not use. Takes 45 s of a processor.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

import leapgap as lg

HARDWARE = "{effects: [{name: joint_damping, location: all, damping: 1.0}]}"
JUMPS, HELD_OUT = 5, 3
"""What the hidden robot has and its model lacks, its jumps, and the one that is kept out of the diagnosis and shown."""
BEGIN_S, END_S, FRAME_S, SHOWN_MS = 0.5, 1.3, 0.025, 70
"""Part of the jump that is shown, time between frames, and for how long each is shown."""
PANEL, PLOT, HEAD = (300, 260), 110, 24
"""Size of a panel, height of the curves below, height of the labels, pixels."""
COLOURS = {"measured": (64, 110, 180), "nominal": (214, 110, 40), "corrected": (40, 140, 80)}
GHOST = (0.25, 0.43, 0.71, 0.35)
INK, PAPER, GRID = (45, 50, 58), (255, 255, 255), (215, 219, 226)
PALETTE = 96
LARGEST_BYTES = 2_000_000


def jumps(folder: Path) -> list[lg.Log]:
    """Logs of the hidden robot."""
    command = [sys.executable, "-m", "stages.collect", f"collect.references={folder}/plans", f"collect.jumps={JUMPS}"]
    hidden = ["collect.hardware=hidden", f"+collect.variants.hidden={HARDWARE}", f"collect.out={folder}/logs"]
    subprocess.run([*command, *hidden], check=True)
    return lg.read_logs(folder / "logs")


def poses(log: lg.Log, robot: lg.Robot) -> np.ndarray:
    """Generalised positions of a log's samples, (samples, nq)."""
    base = [f"base_pos_{axis}" for axis in "xyz"] + [f"base_quat_{axis}" for axis in "wxyz"]
    qpos = np.zeros((len(log), robot.model.nq))
    qpos[:, :7] = np.column_stack([log[name] for name in base])
    qpos[:, robot.joint_qpos] = log.per_joint("joint_pos")
    return qpos


class Stage:
    """The robot as it is drawn: one model, one camera, an optional translucent second robot."""

    def __init__(self, robot: lg.Robot, height_m: float) -> None:
        self.model = robot.model
        self.data, self.ghost = mujoco.MjData(self.model), mujoco.MjData(self.model)
        self.renderer = mujoco.Renderer(self.model, PANEL[1], PANEL[0])
        self.camera, self.option, self.perturb = mujoco.MjvCamera(), mujoco.MjvOption(), mujoco.MjvPerturb()
        self.camera.azimuth, self.camera.elevation, self.camera.distance = 90.0, -8.0, 1.15
        self.camera.lookat[:] = 0.0, 0.0, height_m

    def draw(self, qpos: np.ndarray, ghost: np.ndarray | None, x_m: float) -> Image.Image:
        """The robot in a pose, with another pose translucent behind it."""
        self.camera.lookat[0] = x_m
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        self.renderer.update_scene(self.data, self.camera, self.option)
        if ghost is not None:
            self.ghost.qpos[:] = ghost
            mujoco.mj_kinematics(self.model, self.ghost)
            scene, first = self.renderer.scene, self.renderer.scene.ngeom
            moving = int(mujoco.mjtCatBit.mjCAT_DYNAMIC)
            mujoco.mjv_addGeoms(self.model, self.ghost, self.option, self.perturb, moving, scene)
            for geom in scene.geoms[first : scene.ngeom]:
                geom.rgba[:] = GHOST
        pixels = self.renderer.render().copy()
        self.renderer.enable_segmentation_rendering()
        pixels[self.renderer.render()[..., 0] < 0] = PAPER  # the sky
        self.renderer.disable_segmentation_rendering()
        return Image.fromarray(pixels)


def curves(size: tuple[int, int], time_s: np.ndarray, errors_cm: dict[str, np.ndarray], now: int) -> Image.Image:
    """Distance of each simulated trunk from the measured one up to a sample, cm."""
    image = Image.new("RGB", size, PAPER)
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(12)
    left, top, right, bottom = 36, 22, size[0] - 12, size[1] - 18
    largest = max(errors.max() for errors in errors_cm.values())
    draw.text((left, 3), "error of the simulated trunk's position, cm", INK, font)
    step = 5 if largest > 7 else 2
    for tick in np.arange(0, largest + 1e-9, step):
        y = bottom - (bottom - top) * tick / largest
        draw.line([(left, y), (right, y)], GRID)
        draw.text((8, y - 7), f"{tick:.0f}", INK, font)
    span = time_s[-1] - time_s[0]
    for name, errors in errors_cm.items():
        x = left + (right - left) * (time_s[: now + 1] - time_s[0]) / span
        y = bottom - (bottom - top) * errors[: now + 1] / largest
        points = list(zip(x, y, strict=True))
        if len(points) > 1:
            draw.line(points, COLOURS[name], 2)
    draw.text((right - 40, bottom + 2), f"{time_s[now]:.2f} s", INK, font)
    return image


def frames(robot: lg.Robot, shown: dict[str, lg.Log]) -> list[Image.Image]:
    """The frames: three panels side by side, and the error of the trunk below."""
    measured = shown["measured"]
    qpos = {name: poses(log, robot) for name, log in shown.items()}
    period = measured.info.sample_period_s
    rows = np.arange(round(BEGIN_S / period), round(END_S / period), round(FRAME_S / period))
    trunk = {name: motion[rows, :3] for name, motion in qpos.items()}
    errors = {name: 100 * np.linalg.norm(trunk[name] - trunk["measured"], axis=1) for name in ("nominal", "corrected")}
    stage, font = Stage(robot, float(trunk["measured"][:, 2].mean())), ImageFont.load_default(15)
    labels = {"measured": "measured robot", "nominal": "nominal simulation", "corrected": "corrected simulation"}
    found = []
    for i, row in enumerate(rows):
        image = Image.new("RGB", (3 * PANEL[0], HEAD + PANEL[1] + PLOT), PAPER)
        draw = ImageDraw.Draw(image)
        for k, (name, label) in enumerate(labels.items()):
            ghost = None if name == "measured" else qpos["measured"][row]
            x_m = float(trunk["measured"][i, 0])
            image.paste(stage.draw(qpos[name][row], ghost, x_m), (k * PANEL[0], HEAD))
            text = label if name == "measured" else f"{label}: {errors[name][i]:.1f} cm off"
            draw.text((k * PANEL[0] + 8, 3), text, COLOURS[name], font)
        size = (image.width, PLOT)
        image.paste(curves(size, measured.time[rows], errors, i), (0, HEAD + PANEL[1]))
        found.append(image)
    return found


def write(images: list[Image.Image], path: Path) -> None:
    """Write an animated PNG or GIF of few colours; the last frame stands for a second."""
    palette = images[len(images) // 2].quantize(PALETTE)
    small = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    durations = [SHOWN_MS] * (len(small) - 1) + [1500]
    small[0].save(path, save_all=True, append_images=small[1:], duration=durations, loop=0, optimize=True)
    size = path.stat().st_size
    print(f"{path}: {len(small)} frames, {size / 1e3:.0f} kB")
    if size > LARGEST_BYTES:
        sys.exit(f"{path}: {size} bytes; expected {LARGEST_BYTES} at most")


def main(path: Path) -> None:
    """Make the picture."""
    with tempfile.TemporaryDirectory() as folder:
        logs = jumps(Path(folder))
        robot = lg.Robot.load()
        kept_out = logs.pop(HELD_OUT)
        report = lg.diagnose(logs, robot, progress=print)
        print(report)
        [nominal] = lg.replay([kept_out], robot)
        [corrected] = lg.replay([kept_out], robot, report.correction)
        write(frames(robot, {"measured": kept_out, "nominal": nominal, "corrected": corrected}), path)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
