"""The columns of a log as data: name, unit and kind of each quantity."""

from dataclasses import dataclass

from leapgap.robot.topology import PAIRS


@dataclass(frozen=True)
class Quantity:
    """One logged quantity: a column for each component of the base, or one for each joint or foot."""

    name: str
    unit: str
    per: str
    """``base``, ``joint``, ``foot``, ``pair`` or ``log``: one value a row."""
    meaning: str
    components: tuple[str, ...] = ()
    """Suffixes of the name in the columns of the base."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of a quantity of the base: ``base_pos_x`` and so on."""
        return tuple(f"{self.name}_{component}" for component in self.components)

    def column(self, of: str) -> str:
        """Column of one joint, foot or pair: ``joint_pos/FR_calf``."""
        return f"{self.name}/{of}"


PAIR_FORCE_AXES = tuple(f"{pair}_{axis}" for pair in PAIRS for axis in ("x", "z"))
"""Components of a force of each pair of feet: ``front_x``, ``front_z``, ``rear_x``, ``rear_z``."""
XYZ, WXYZ = ("x", "y", "z"), ("w", "x", "y", "z")

QUANTITIES = {
    quantity.name: quantity
    for quantity in (
        Quantity("base_pos", "m", "base", "origin of the base body in the world", XYZ),
        Quantity("base_quat", "1", "base", "base to world", WXYZ),
        Quantity("base_linvel", "m/s", "base", "velocity of that origin in the world", XYZ),
        Quantity("base_angvel", "rad/s", "base", "in base axes, as a gyro reads it", XYZ),
        Quantity("imu_acc", "m/s²", "base", "acceleration that the IMU measured", XYZ),
        Quantity("joint_pos", "rad", "joint", "measured position"),
        Quantity("joint_vel", "rad/s", "joint", "measured velocity"),
        Quantity("tau", "N·m", "joint", "measured torque"),
        Quantity("cmd_tau", "N·m", "joint", "feed-forward torque that was sent"),
        Quantity("cmd_pos", "rad", "joint", "set point of the joint PD"),
        Quantity("cmd_vel", "rad/s", "joint", "set point of the joint PD"),
        Quantity("cmd_kp", "N·m/rad", "joint", "gain of the joint PD"),
        Quantity("cmd_kd", "N·m·s/rad", "joint", "gain of the joint PD"),
        Quantity("foot_force", "N", "foot", "foot sensor, as logged"),
        Quantity("contact", "1", "foot", "1 where the foot touches, 0 where it does not"),
        Quantity("supply_voltage", "V", "log", "of the motors' supply"),
        Quantity("mpc_force", "N", "pair", "ground force on the robot that the MPC asked for", PAIR_FORCE_AXES),
        Quantity("pd_force", "N", "pair", "ground force that the joint PD stands for", PAIR_FORCE_AXES),
        Quantity("train_force", "N", "pair", "the source's own filtered force", PAIR_FORCE_AXES),
    )
}
"""Every quantity by name; a log holds some of them, and may hold other columns."""

BASE_POSITION = QUANTITIES["base_pos"].columns
BASE_QUATERNION = QUANTITIES["base_quat"].columns
BASE_VELOCITY = QUANTITIES["base_linvel"].columns
BASE_ANGULAR_VELOCITY = QUANTITIES["base_angvel"].columns
COMMANDS = ("cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")


def quantity_of(column: str) -> Quantity | None:
    """The quantity that a column holds; None for ``time`` and for unknown columns."""
    name, _, part = column.partition("/")
    if name in QUANTITIES and bool(part) == (QUANTITIES[name].per in ("joint", "foot", "pair")):
        return QUANTITIES[name]
    return next((quantity for quantity in QUANTITIES.values() if column in quantity.columns), None)
