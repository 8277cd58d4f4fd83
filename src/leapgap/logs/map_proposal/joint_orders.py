"""Orders in which makers and simulators number the joints of a robot, and which of them a table of positions fits."""

from collections.abc import Iterator, Sequence

import numpy as np

from leapgap.logs.importers.units import UNITS
from leapgap.logs.map_proposal.joint_limits import SPUN_RAD, inside, real_limits
from leapgap.robot.model import Robot

MODEL = "in the order of the model"


def known_orders(robot: Robot) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Orders of the joints, each with what it is called, the likeliest first."""
    joints = robot.joints
    yield MODEL, joints
    depth = dict(zip(joints, levels(robot), strict=True))
    breadth = "kind by kind through the tree of the model (breadth-first, as Isaac Lab has them)"
    yield breadth, tuple(sorted(joints, key=lambda joint: depth[joint]))
    yield f"{breadth}, branches by the alphabet", tuple(sorted(joints, key=lambda joint: (depth[joint], joint)))
    stated = tuple(motor.target for motor in robot.published_spec().actuators)
    if set(stated) == set(joints):
        yield "in the order of the model file's actuators", stated
    yield "by the alphabet", tuple(sorted(joints))


def levels(robot: Robot) -> list[int]:
    """Number of joints between each joint and the base."""
    model = robot.model

    def level(body: int) -> int:
        if body == 0:
            return 0
        return level(int(model.body_parentid[body])) + int(np.isin(robot.joint_bodies, body).sum())

    return [level(int(model.body_parentid[body])) for body in robot.joint_bodies]


def fitting_order(position: np.ndarray, robot: Robot) -> tuple[str, Sequence[str], list[str]]:
    """The first order in which positions (rows, joints) lie within the limits, in rad or deg, and others that fit too.

    The model's own where none does.
    """
    limits, real = real_limits(robot)
    unit = UNITS["rad"]["rad" if np.nanmax(np.abs(position)) < 1.5 * SPUN_RAD else "deg"]
    low, high = np.nanmin(position, axis=0), np.nanmax(position, axis=0)

    def fits(order: Sequence[str], turned: bool) -> bool:
        at = [order.index(joint) for joint in robot.joints]
        good = inside(low[at] * unit, high[at] * unit, limits)
        return bool((good | (turned & inside(-high[at] * unit, -low[at] * unit, limits)))[real].all())

    every = {order: words for words, order in reversed([*known_orders(robot)])}
    for turned in (False, True):  # joints that count backwards are thought of last
        found = [order for order in reversed(every) if fits(order, turned)]
        if found:
            return every[found[0]], found[0], [every[order] for order in found[1:]]
    return MODEL, robot.joints, []
