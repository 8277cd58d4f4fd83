"""Pictures of how each effect shows in a jump, <effect>.svg: a replay with it minus one without.

    python docs/signature_pictures.py data/references/own/h00_d50.parquet docs/research/signatures

Both replays begin with the same row and get the same commands. Each effect has its moderate size. The last part of the
flight is left out, in which some of the robots touch down already.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from docs.effect_signatures import moderate_effects
from leapgap.diagnosis.localisation import phase_names, phase_of_rows
from leapgap.errors import InputError
from leapgap.logs.log import Log, read_log
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.runtime.atomic_io import write_text
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout

JOINT = "RR_calf"
CHANNELS = (
    ("rear knee", "rad", 0.01),
    ("rear knee, speed", "rad/s", 0.3),
    ("vertical velocity", "m/s", 0.05),
    ("pitch rate", "rad/s", 0.1),
)
"""What is drawn, its unit, and its scale as in ``docs.effect_signatures``."""
SILENT = 0.1
"""Below this share of a scale a line is drawn flat."""
WIDTH, HEIGHT, GAP, TOP, BOTTOM = 150, 64, 12, 18, 16
"""Of one panel, between two, and above and below them, pixels."""
MOST_POINTS = 160
SHOWN_OF_FLIGHT = 0.6
"""Share of the flight that is drawn."""
LINE, AXIS, TEXT, GROUND, FLIGHT = "#d1495b", "#8a8f98", "#30343b", "#eef1f5", "#ffffff"


@dataclass(frozen=True)
class Jump:
    """The part of a jump that is drawn."""

    time_s: np.ndarray
    flight_s: float
    """When the last foot leaves the ground."""


def columns_of(motion: Motion, robot: Robot, rows: int) -> np.ndarray:
    """The channels of the first rows of a motion, (rows, 4)."""
    joint = robot.joints.index(JOINT)
    qpos, qvel = motion.qpos[:rows], motion.qvel[:rows]
    return np.column_stack([qpos[:, robot.joint_qpos[joint]], qvel[:, robot.joint_dofs[joint]], qvel[:, 2], qvel[:, 4]])


def drawn_part(log: Log) -> Jump:
    """Time of the rows up to the middle of the flight, about."""
    names = phase_names([log])
    phase = np.array(names)[phase_of_rows(log, names)]
    flight = np.flatnonzero(phase == "flight")
    if not len(flight):
        raise InputError("log", "no flight", "a jump", "choose a plan of a jump")
    last = flight[0] + round(SHOWN_OF_FLIGHT * len(flight))
    time_s = np.arange(last) * log.info.sample_period_s
    return Jump(time_s, float(time_s[flight[0]]))


def panel(left: float, jump: Jump, values: np.ndarray, channel: tuple[str, str, float]) -> str:
    """One channel: its difference over time about a line at zero, in its own scale, which the label says."""
    name, unit, scale = channel
    largest = float(np.abs(values).max())
    silent = largest < SILENT * scale
    reach = 1.0 if silent else largest
    step = max(1, len(values) // MOST_POINTS)
    x = left + WIDTH * jump.time_s[::step] / jump.time_s[-1]
    y = TOP + HEIGHT * (0.5 - 0.46 * (0 * values if silent else values)[::step] / reach)
    off = left + WIDTH * jump.flight_s / jump.time_s[-1]
    label = f"{name}: nothing" if silent else f"{name}: ±{largest:.2g} {unit}"
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    middle = TOP + HEIGHT / 2
    return "\n".join(
        [
            f'<rect x="{left:.1f}" y="{TOP}" width="{off - left:.1f}" height="{HEIGHT}" fill="{GROUND}"/>',
            f'<path d="M{left:.1f} {middle}h{WIDTH}" stroke="{AXIS}" stroke-width="0.6"/>',
            f'<polyline points="{points}" fill="none" stroke="{LINE}" stroke-width="1.4"/>',
            f'<text x="{left:.1f}" y="{TOP - 5}">{label}</text>',
        ]
    )


def picture(title: str, jump: Jump, difference: np.ndarray) -> str:
    """The panels of one effect side by side; grey is the ground contact, white the flight."""
    width = len(CHANNELS) * (WIDTH + GAP) + GAP
    height = TOP + HEIGHT + BOTTOM
    panels = [panel(GAP + i * (WIDTH + GAP), jump, difference[:, i], channel) for i, channel in enumerate(CHANNELS)]
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
            f' role="img" font-family="sans-serif" font-size="9.5" fill="{TEXT}">',
            f"<title>{title}</title>",
            f'<rect width="{width}" height="{height}" fill="{FLIGHT}"/>',
            *panels,
            f'<text x="{GAP}" y="{height - 5}" fill="{AXIS}">{jump.time_s[-1]:.2f} s; grey: feet on the ground,'
            " white: flight</text>",
            "</svg>\n",
        ]
    )


def draw(log: Log, robot: Robot, out: Path) -> list[Path]:
    """Write a picture of every effect that is known; their paths."""
    chosen = moderate_effects(robot)
    replayer = Replayer(robot, terrain_slots=max(1, len(log.info.terrain)))
    jump = drawn_part(log)
    rows = len(jump.time_s)
    trials = [Rollout(log), *(Rollout(log, (effect,)) for effect in chosen.values())]
    nominal, *others = (columns_of(motion, robot, rows) for motion in replayer.motions(trials))
    paths = []
    for (label, effect), own in zip(chosen.items(), others, strict=True):
        stem = label.replace(": ", "_")
        paths.append(out / f"{stem}.svg")
        write_text(paths[-1], picture(f"{label}: {effect}".replace("<", "").replace("&", ""), jump, own - nominal))
    return paths


def main(arguments: Sequence[str]) -> None:
    """Draw all effects on the jump of a log."""
    if len(arguments) != 2:
        raise InputError("arguments", " ".join(arguments) or "none", "<reference.parquet> <folder>", "give both")
    out = Path(arguments[1])
    out.mkdir(parents=True, exist_ok=True)
    paths = draw(read_log(Path(arguments[0])), Robot.load(), out)
    print(f"{len(paths)} pictures, {sum(path.stat().st_size for path in paths) / 1e3:.0f} kB -> {out}")


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except InputError as error:
        sys.exit(f"signature_pictures: {error}")
