"""The legs of a robot as tables of links, which the exported controllers follow without MuJoCo."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.control.leg_kinematics import foot_share
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class LegChains:
    """For each foot the links from the base to it, one after another, and the joints that turn them."""

    links_of_foot: np.ndarray  # First link of each foot in the tables of links, and their number, int, (feet + 1,)
    link_position: np.ndarray
    link_rotation: np.ndarray  # In the link before, m, (links, 3) and (links, 9)
    link_joint: np.ndarray  # Joint that turns the link, or −1, int, (links,)
    link_axis: np.ndarray
    link_anchor: np.ndarray  # Of that joint, in the link, (links, 3)
    link_zero: np.ndarray  # Angle of the joint at which the link is as tabled, rad, (links,)
    foot_point: np.ndarray  # Centre of the foot in its last link, m, (feet, 3)
    foot_share: np.ndarray  # Part of the foot in the mean of the front and of the rear pair, (feet, 2)

    @staticmethod
    def of(robot: Robot) -> "LegChains":
        """The legs of a robot; ``InputError`` where a link has more than one joint, or one that is no hinge."""
        model, hinge = robot.model, int(mujoco.mjtJoint.mjJNT_HINGE)
        numbers = {int(body): i for i, body in enumerate(robot.joint_bodies)}
        links: list[tuple[np.ndarray, np.ndarray, int, np.ndarray, np.ndarray, float]] = []
        begins = [0]
        for geom in robot.foot_geoms:
            chain, body = [], int(model.geom_bodyid[geom])
            while body != robot.base_body:
                chain.append(body)
                body = int(model.body_parentid[body])
            for body in reversed(chain):
                joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
                if len(joints) > 1 or any(model.jnt_type[joint] != hinge for joint in joints):
                    found = f"{len(joints)} joints at {model.body(body).name}"
                    raise InputError(robot.path, found, "at most one hinge at each link of a leg", "split the link")
                place, turn = model.body_pos[body], np.zeros(9)
                mujoco.mju_quat2Mat(turn, model.body_quat[body])
                if not len(joints):
                    links.append((place, turn, -1, np.zeros(3), np.zeros(3), 0.0))
                    continue
                joint = joints[0]
                zero = float(model.qpos0[model.jnt_qposadr[joint]])
                links.append((place, turn, numbers[body], model.jnt_axis[joint], model.jnt_pos[joint], zero))
            begins.append(len(links))
        position, rotation, joint_of, axis, anchor, zeros = zip(*links, strict=True)
        return LegChains(
            np.array(begins, np.int32),
            *(np.array(position), np.array(rotation), np.array(joint_of, np.int32)),
            *(np.array(axis), np.array(anchor), np.array(zeros)),
            *(model.geom_pos[robot.foot_geoms].copy(), foot_share(robot)),
        )
