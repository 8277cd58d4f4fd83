"""Names of channels in words, with their units, as pages show them."""

from leapgap.logs.schema import QUANTITIES, quantity_of
from leapgap.robot.model import Robot

LABELS = {
    "base_pos_x": "forward x",
    "base_pos_y": "sideways y",
    "base_pos_z": "height z",
    "base_roll": "roll",
    "base_pitch": "pitch (nose down)",
    "base_yaw": "yaw",
    "base_linvel_x": "forward velocity",
    "base_linvel_y": "sideways velocity",
    "base_linvel_z": "vertical velocity",
    "base_angvel_x": "roll rate",
    "base_angvel_y": "pitch rate",
    "base_angvel_z": "yaw rate",
    "imu_acc_x": "acceleration x of the IMU",
    "imu_acc_y": "acceleration y of the IMU",
    "imu_acc_z": "acceleration z of the IMU",
}
JOINT_WORDS = {"joint_pos": "position", "joint_vel": "velocity", "foot_force": "force"}


def row_of(channel: str, robot: Robot) -> str:
    """Label of a channel's row in the map, such as ``forward x`` or ``rear calf velocity``.

    A joint channel is named by the pair of its leg, its joint group and its quantity. Where the legs are not two pairs,
    the name of the limb stands in place of the pair.
    """
    if channel in LABELS:
        return LABELS[channel]
    quantity, _, joint = channel.partition("/")
    what = JOINT_WORDS[quantity]
    if quantity == "foot_force":
        return f"{joint} foot {what}"
    group = next((name for name, alike in robot.topology.groups.items() if joint in alike), None)
    if group is None:
        return f"{joint} {what}"
    limb = robot.limb_of(joint)
    pair = next((name for name, limbs in robot.limbs_of_pair.items() if limb in limbs), limb)
    return f"{pair} {group} {what}"


def channel_title(channel: str) -> str:
    """Label and unit of a channel, such as ``height z, m`` or ``elbow velocity, rad/s``."""
    return f"{channel_words(channel)}, {unit_of(channel)}"


def unit_of(channel: str) -> str:
    """Unit of a channel; roll, pitch and yaw are no quantities of a log."""
    known = QUANTITIES.get(channel.partition("/")[0]) or quantity_of(channel)
    return known.unit if known else "rad"


def channel_words(channel: str) -> str:
    """Label of a channel, such as ``height z`` or ``elbow velocity``."""
    if channel in LABELS:
        return LABELS[channel]
    quantity, _, joint = channel.partition("/")
    return f"{joint} {JOINT_WORDS[quantity]}"
