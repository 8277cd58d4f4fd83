"""Sensors of a robot that its state does not hold: the accelerometer of its IMU, and the force under each foot."""

from collections.abc import Sequence

import mujoco
import numpy as np

from leapgap.robot.model import Robot

IMU_ACCELERATION = ("imu_acc_x", "imu_acc_y", "imu_acc_z")  # specific force in the IMU's axes, m/s²: at rest 1 g up
FOOT_FORCE = "foot_force/"  # before the name of a foot: the normal force on it, N
SENSOR = "leapgap "  # before the names of the sensors that are added to a model
AROUND = 1.5  # the zone in which contacts of a foot count, as a multiple of the radius of a ball around it


def sensor_columns(robot: Robot) -> tuple[str, ...]:
    """Columns of the sensors that can be simulated on a robot; none for an IMU or feet that its model lacks."""
    of_imu = () if imu_site(robot) is None else IMU_ACCELERATION
    return (*of_imu, *(FOOT_FORCE + foot for foot in robot.feet))


def imu_site(robot: Robot) -> str | None:
    """The site of the IMU: that of the model's accelerometer, else one with ``imu`` in its name; None without either.

    Where there are several, it is the first on the base.
    """
    model = robot.model
    kind = int(mujoco.mjtSensor.mjSENS_ACCELEROMETER)
    measured = [int(model.sensor_objid[s]) for s in np.flatnonzero(model.sensor_type == kind)]
    named = [s for s in range(model.nsite) if "imu" in model.site(s).name.lower()]
    for sites in (measured, named):
        on_base = [s for s in sites if int(model.site_bodyid[s]) == robot.base_body]
        for site in (*on_base, *sites):
            if model.site(site).name:
                return str(model.site(site).name)
    return None


def add_sensors(spec: mujoco.MjSpec, robot: Robot, columns: Sequence[str]) -> None:
    """Add MuJoCo's own sensors for some columns to a specification of the robot."""
    at_site = mujoco.mjtObj.mjOBJ_SITE
    if set(columns) & set(IMU_ACCELERATION):
        kind = mujoco.mjtSensor.mjSENS_ACCELEROMETER
        spec.add_sensor(name=SENSOR + "imu_acc", type=kind, objtype=at_site, objname=imu_site(robot))
    for foot, geom in zip(robot.feet, robot.foot_geoms, strict=True):
        if FOOT_FORCE + foot not in columns:
            continue
        zone = spec.geom(robot.model.geom(geom).name).parent.add_site()
        zone.name = f"{SENSOR}{foot}"
        zone.pos, zone.size = robot.model.geom_pos[geom], [AROUND * robot.model.geom_rbound[geom]] * 3
        zone.type, kind = mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtSensor.mjSENS_TOUCH
        spec.add_sensor(name=SENSOR + FOOT_FORCE + foot, type=kind, objtype=at_site, objname=zone.name)


def sensor_addresses(model: mujoco.MjModel, columns: Sequence[str]) -> np.ndarray:
    """Where the added sensors of some columns stand in ``sensordata``, (columns,)."""
    found = []
    for column in columns:
        of_imu = column in IMU_ACCELERATION
        first = int(model.sensor(SENSOR + ("imu_acc" if of_imu else column)).adr[0])
        found.append(first + (IMU_ACCELERATION.index(column) if of_imu else 0))
    return np.array(found, dtype=int)
