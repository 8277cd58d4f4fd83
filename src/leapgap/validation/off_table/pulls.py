"""External forces: a tether, wind, a sticky floor."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.effects.base import parameter
from leapgap.effects.contacts import foot_geoms
from leapgap.logs.log import Log
from leapgap.logs.schema import BASE_POSITION
from leapgap.robot.model import Robot
from leapgap.validation.off_table.base import OffTableEffect, Process

ANCHOR_M = np.array([-1.0, 0.0, 0.4])
"""Anchor of the tether relative to the first position of the trunk, m: behind and above it."""
DRAG_AREA = 0.1
"""½ ρ c_d A of a quadruped from the front, N·s²/m²: about 0.6 kg/m³ × 1.3 × 0.12 m²."""
STICKY_M = 0.005
"""Height above the ground up to which the floor holds a foot."""
RISING_M_S = 0.02
"""Speed of a rising foot from which the floor holds with its whole force."""


@dataclass(frozen=True)
class Tether(OffTableEffect):
    """A safety line, slack at the start, that pulls the trunk back like a spring once it is taut."""

    name = "tether"
    needs_base = True

    stiffness_n_m: float = parameter(0.0, "N/m", 0.0, 500.0)

    def process(self, model: mujoco.MjModel, robot: Robot, jump: Log) -> Process | None:
        """Pull at the origin of the trunk."""
        anchor = jump.stack(BASE_POSITION)[0] + ANCHOR_M
        slack = float(np.linalg.norm(ANCHOR_M))
        body = robot.base_body

        def pull(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            line = anchor - data.xpos[body]
            length = float(np.linalg.norm(line))
            if length > slack:
                force = self.stiffness_n_m * (length - slack) * line / length
                mujoco.mj_applyFT(model, data, force, np.zeros(3), data.xpos[body], body, data.qfrc_applied)

        return pull


@dataclass(frozen=True)
class Wind(OffTableEffect):
    """Steady wind along x, positive from behind: drag of the trunk in the wind less its drag in still air."""

    name = "wind"
    needs_base = True

    speed_m_s: float = parameter(0.0, "m/s", -20.0, 20.0)

    def process(self, model: mujoco.MjModel, robot: Robot, jump: Log) -> Process | None:
        """Push at the trunk's centre of mass."""
        body, wind = robot.base_body, np.array([self.speed_m_s, 0.0, 0.0])

        def blow(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            still = -data.qvel[:3]
            air = wind + still
            data.xfrc_applied[body, :3] += DRAG_AREA * (np.linalg.norm(air) * air - np.linalg.norm(still) * still)

        return blow


@dataclass(frozen=True)
class StickyFloor(OffTableEffect):
    """A floor of glue or suction: it pulls down a foot that leaves it, over the first millimetres."""

    name = "sticky_floor"
    places = "feet"

    force_n: float = parameter(0.0, "N", 0.0, 150.0)

    def process(self, model: mujoco.MjModel, robot: Robot, jump: Log) -> Process | None:
        """Hold the feet at the location, each with up to the whole force."""
        geoms = foot_geoms(model, robot, self.location)
        radius = model.geom_size[geoms, 0]
        last: dict[int, float] = {}

        def hold(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            for geom, size in zip(geoms, radius, strict=True):
                centre = data.geom_xpos[geom]
                height = centre[2] - size - top_of_ground(jump, centre)
                rising = (height - last.get(int(geom), height)) / model.opt.timestep
                last[int(geom)] = height
                if height < STICKY_M and rising > 0:
                    force = np.array([0.0, 0.0, -self.force_n * min(1.0, rising / RISING_M_S)])
                    body = int(model.geom_bodyid[geom])
                    mujoco.mj_applyFT(model, data, force, np.zeros(3), centre, body, data.qfrc_applied)

        return hold


def top_of_ground(jump: Log, point: np.ndarray) -> float:
    """Height of the stated ground under a point, m."""
    tops = [
        box.top_m
        for box in jump.info.terrain
        if abs(point[0] - box.x_m) < box.size_m[0] / 2 and abs(point[1] - box.y_m) < box.size_m[1] / 2
    ]
    return max(tops, default=0.0)
