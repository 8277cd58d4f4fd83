"""Planned jumps as one HTML page: each in four pictures, with its cost and its constraint violation."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from leapgap.jumping.task import schedule_of
from leapgap.logs.log import Log, read_log
from leapgap.logs.schema import BASE_POSITION, BASE_QUATERNION
from leapgap.reports.page import render_page
from leapgap.robot.kinematics import Poses, body_poses
from leapgap.robot.model import Robot
from leapgap.robot.terrain import Box

PIXELS_PER_M = 190
AROUND_M = 0.42  # Half the width of a picture, centred on the base
BELOW_M, ABOVE_M = 0.06, 0.3  # Margins of a picture: below the floor, and above the highest point of the base
COLOURS = {"front": "#2563c9", "rear": "#e2542f", "base": "#111827", "ground": "#e3e7ee"}


def moments(jump: Log) -> dict[str, int]:
    """Row of the log that each picture shows; the apex is the highest point of the base."""
    last = len(jump) - 1
    lift_off = min(int(np.searchsorted(jump.time, schedule_of(jump).take_off_s)), last)
    landing = min(int(np.searchsorted(jump.time, schedule_of(jump).landing_s)), last)
    return {
        "start": 0,
        "lift-off": lift_off,
        "apex": lift_off + int(np.argmax(jump["base_pos_z"][lift_off : landing + 1])),
        "landing": landing,
    }


def keyframes(jump: Log, robot: Robot) -> str:
    """The four pictures side by side as SVG: front legs blue, rear legs red, path of the base dotted."""
    top = float(jump["base_pos_z"].max()) + ABOVE_M
    width, height = 2 * AROUND_M * PIXELS_PER_M, (top + BELOW_M) * PIXELS_PER_M
    rows = moments(jump)
    at = list(rows.values())
    joints, position, quaternion = jump.per_joint("joint_pos", robot.joints), BASE_POSITION, BASE_QUATERNION
    poses = body_poses(robot, joints[at], jump.stack(position)[at], jump.stack(quaternion)[at])
    pictures = []
    for i, (name, row) in enumerate(rows.items()):
        centre = float(jump["base_pos_x"][row])
        caption = f'<text x="{width / 2:.1f}" y="16" class="caption">{name}, {jump.time[row]:.2f} s</text>'
        inside = f"translate({width / 2 - centre * PIXELS_PER_M:.1f} {top * PIXELS_PER_M:.1f})"
        pictures.append(
            f'<svg x="{i * (width + 8):.1f}" width="{width:.1f}" height="{height:.1f}" data-moment="{name}">'
            f'<g transform="{inside}">{scene(jump, robot, poses, i, centre)}</g>{caption}</svg>'
        )
    whole = len(rows) * (width + 8)
    return (
        f'<svg class="strip" viewBox="0 0 {whole:.1f} {height:.1f}" role="img" '
        f'aria-label="{jump.name}: {", ".join(rows)}">{"".join(pictures)}</svg>'
    )


def scene(jump: Log, robot: Robot, poses: Poses, picture: int, centre: float) -> str:
    """SVG of ground, path of the base, legs and trunk in one picture, in pixels with y downwards."""
    rows = np.unique(np.linspace(0, len(jump) - 1, 60).astype(int))
    points = np.stack([jump["base_pos_x"][rows], jump["base_pos_z"][rows]], axis=1)
    path = pixels(points[np.abs(points[:, 0] - centre) < AROUND_M])
    dotted = f'<polyline points="{path}" fill="none" stroke="#8a93a3" stroke-width="1.4" stroke-dasharray="2 4"/>'
    parts = [ground(jump.info.terrain, centre), dotted]
    parts += [leg(robot, poses, picture, foot) for foot in range(len(robot.feet))]
    return "".join([*parts, trunk(robot, poses, picture)])


def ground(terrain: Sequence[Box], centre: float) -> str:
    """SVG of the floor and of the terrain boxes on it."""
    edges = [(centre - 2 * AROUND_M, centre + 2 * AROUND_M, 0.0)]
    edges += [(box.x_m - box.size_m[0] / 2, box.x_m + box.size_m[0] / 2, box.top_m) for box in terrain]
    return "".join(
        f'<rect x="{left * PIXELS_PER_M:.1f}" y="{-high * PIXELS_PER_M:.1f}" '
        f'width="{(right - left) * PIXELS_PER_M:.1f}" height="{(high + BELOW_M) * PIXELS_PER_M:.1f}" '
        f'fill="{COLOURS["ground"]}"/>'
        for left, right, high in edges
    )


def leg(robot: Robot, poses: Poses, picture: int, foot: int) -> str:
    """SVG of one leg: a line from the trunk over its joints to the foot."""
    geom = robot.foot_geoms[foot]
    chain, body = [poses.feet[picture, foot]], robot.model.geom_bodyid[geom]
    while body not in (0, robot.base_body):
        chain.append(poses.positions[picture, body - robot.base_body])
        body = robot.model.body_parentid[body]
    colour = COLOURS["front" if robot.feet[foot] in robot.feet_of_pair("front") else "rear"]
    bones = pixels(np.array(chain)[:, [0, 2]])
    x, y = bones.split()[0].split(",")
    return (
        f'<polyline points="{bones}" fill="none" stroke="{colour}" stroke-width="5" stroke-linejoin="round" '
        f'stroke-linecap="round"/><circle cx="{x}" cy="{y}" r="{robot.foot_radius[foot] * PIXELS_PER_M:.1f}" '
        f'fill="{colour}"/>'
    )


def trunk(robot: Robot, poses: Poses, picture: int) -> str:
    """SVG of the trunk: a line from the rear hips to the front hips."""
    base = robot.base_body
    hips = np.array([i for i in range(base + 1, robot.model.nbody) if robot.model.body_parentid[i] == base])
    along = poses.positions[picture, hips - base][:, [0, 2]]
    ends = along[np.argsort(robot.model.body_pos[hips][:, 0])][[0, -1]]
    return f'<polyline points="{pixels(ends)}" stroke="{COLOURS["base"]}" stroke-width="17" stroke-linecap="round"/>'


def pixels(points: np.ndarray) -> str:
    """Points in m, (n, 2), x forward and z up, as an SVG list of points in pixels."""
    return " ".join(f"{PIXELS_PER_M * x:.1f},{-PIXELS_PER_M * z:.1f}" for x, z in points)


def html(folder: Path, robot: Robot) -> str:
    """The page of a folder of references with its index."""
    jumps = []
    for entry in json.loads((folder / "references.json").read_text()):
        jump = read_log(folder / entry["file"])
        torque = jump.per_joint("cmd_tau", robot.joints)
        drawn = {
            "strip": keyframes(jump, robot),
            "apex_m": float(jump["base_pos_z"].max()),
            "torque_nm": float(abs(torque).max()),
        }
        jumps.append(entry | drawn)
    return render_page(Path(__file__).with_name("references.html"), {}, jumps=jumps)
