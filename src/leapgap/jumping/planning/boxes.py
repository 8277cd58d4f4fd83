"""Positions of the boxes that jumps land on."""

from leapgap.jumping.models.planar import PlanarRobot
from leapgap.jumping.planning.problem import start_feet
from leapgap.jumping.task import Target
from leapgap.robot.terrain import Box

BOX_MARGIN = 0.05
"""m, least distance of a box from the feet that start in front of it: knees bend beyond them."""
BOX_EDGES = (1.2, 1.0)
"""m, along x and y: room to land and stand."""


def terrain(robot: PlanarRobot, target: Target) -> tuple[Box, ...]:
    """The box a jump lands on, if it lands higher than it started.

    Its near edge lies midway between the feet that start in front of it and those that land on it; where
    these overlap (boxes nearer than about 0.46 m), just beyond the feet at the start.
    """
    if target.z_m == 0:
        return ()
    (front, _), (rear, _) = start_feet(robot)
    forward = 1.0 if target.x_m >= 0 else -1.0
    leading, trailing = (front, rear) if forward > 0 else (rear, front)
    last_at_start = forward * leading + robot.foot_radius
    first_at_landing = forward * (target.x_m + trailing) - robot.foot_radius
    near = max(last_at_start + BOX_MARGIN, (last_at_start + first_at_landing) / 2)
    size = (BOX_EDGES[0], BOX_EDGES[1], target.z_m)
    return (Box(x_m=forward * (near + BOX_EDGES[0] / 2), y_m=0.0, size_m=size, top_m=target.z_m),)
