"""Meshes that nothing can touch are left out of models that are simulated, and nothing that is simulated changes."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap.robot.model import Robot

MESH = """<mesh name="rod" vertex="0 0 0  0.3 0 0  0.3 0.04 0  0 0.04 0
  0 0 0.05  0.3 0 0.05  0.3 0.04 0.05  0 0.04 0.05"/>"""


def arm(folder: Path, bits: str, floor: str = "", pair: str = "") -> Path:
    """An arm of two links whose geoms are meshes; the upper one has no inertia but that of its mesh."""
    path = folder / "arm.xml"
    path.write_text(
        f"""<mujoco><asset>{MESH}</asset><worldbody>{floor}
        <body name="upper" pos="0 0 1"><joint name="shoulder" axis="0 1 0"/>
          <geom name="upper" type="mesh" mesh="rod" {bits}/>
          <body name="lower" pos="0.5 0 0"><joint name="elbow" axis="0 1 0"/>
            <inertial pos="0.1 0 0" mass="0.5" diaginertia="0.01 0.02 0.02"/>
            <geom name="lower" type="mesh" mesh="rod" {bits}/></body></body></worldbody>
        <actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator>{pair}</mujoco>"""
    )
    return path


def swing(model: mujoco.MjModel) -> np.ndarray:
    """Angles of the joints as they fall, by plain MuJoCo, (steps, 2)."""
    data, found = mujoco.MjData(model), []
    for _ in range(400):
        mujoco.mj_step(model, data)
        found.append(data.qpos.copy())
    return np.array(found)


FLOOR = """<geom name="floor" type="plane" size="3 3 0.1" contype="1" conaffinity="0"/>"""
PAIR = """<contact><pair geom1="upper" geom2="lower"/></contact>"""


@pytest.mark.parametrize(
    ("bits", "floor", "pair", "left"),
    [
        ("contype='0' conaffinity='1'", "", "", 0),
        ("contype='0' conaffinity='1'", FLOOR, "", 2),
        ("contype='1' conaffinity='1'", "", "", 2),
        ("contype='0' conaffinity='0'", "", "", 0),
        ("contype='0' conaffinity='1'", "", PAIR, 2),
    ],
)
def test_only_meshes_that_nothing_touches_are_left_out(
    tmp_path: Path, bits: str, floor: str, pair: str, left: int
) -> None:
    path = arm(tmp_path, bits, floor, pair)
    plain, lean = mujoco.MjModel.from_xml_path(str(path)), Robot.load(path, fix_base=True).on_terrain(())
    assert lean.nmesh == (1 if left else 0)
    assert sum(lean.geom_type == int(mujoco.mjtGeom.mjGEOM_MESH)) == left
    assert np.allclose(lean.body_mass, plain.body_mass) and np.allclose(lean.body_inertia, plain.body_inertia)
    assert np.abs(swing(lean) - swing(plain)).max() < 1e-9
