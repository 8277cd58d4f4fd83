"""Orders in which makers and simulators number the joints of a robot, and which of them a table of positions fits."""

from collections.abc import Iterator, Sequence

import numpy as np

from leapgap.logs.importers.units import UNITS
from leapgap.logs.map_proposal.joint_limits import inside, real_limits
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
    low, high = np.nanmin(position, axis=0), np.nanmax(position, axis=0)

    def fits(order: Sequence[str]) -> bool:
        at = [order.index(joint) for joint in robot.joints]
        units = (UNITS["rad"]["rad"], UNITS["rad"]["deg"])
        return any(inside(low[at] * unit, high[at] * unit, limits)[real].all() for unit in units)

    found: dict[tuple[str, ...], str] = {}
    for words, order in known_orders(robot):
        if order not in found and fits(order):
            found[order] = words
    if not found:
        return MODEL, robot.joints, []
    (order, words), *others = found.items()
    return words, order, [other for _, other in others]
