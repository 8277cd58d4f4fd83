"""Where the gap lies, with intervals: legs that swing alike by plain MuJoCo, of which one or both have damping."""

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.localisation import Place, Shares, localise
from leapgap.logs.log import Log, LogInfo
from leapgap.logs.metadata import Segment
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer

LEG = """<body name="{name}_upper" pos="{x} {y} 0"><joint name="{name}_hip" axis="0 1 0" damping="0.02"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.3" contype="0" conaffinity="0"/>
  <body name="{name}_lower" pos="0 0 -0.2"><joint name="{name}_knee" axis="0 1 0" damping="{damping}"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.3" contype="0" conaffinity="0"/>
  <geom name="{name}" type="sphere" pos="0 0 -0.22" size="0.02" mass="0.05"/></body></body>"""
LEGS = {"FL": (0.2, 0.1), "FR": (0.2, -0.1), "RL": (-0.2, 0.1), "RR": (-0.2, -0.1)}
JOINTS = [f"{leg}_{part}" for leg in LEGS for part in ("hip", "knee")]
PERIOD_S, KP, KD = 0.002, 8.0, 0.1


def model(damping: dict[str, float]) -> str:
    """A trunk that falls freely with four legs of two joints each."""
    legs = "".join(
        LEG.format(name=name, x=x, y=y, damping=0.02 + damping.get(name, 0.0)) for name, (x, y) in LEGS.items()
    )
    motors = "".join(f'<motor joint="{joint}" ctrlrange="-20 20" forcerange="-20 20"/>' for joint in JOINTS)
    return f"""<mujoco model="four"><option timestep="0.001"/><worldbody>
      <body name="trunk" pos="0 0 9"><freejoint/><geom type="box" size="0.2 0.1 0.05" mass="5"/>{legs}</body>
      </worldbody><actuator>{motors}</actuator></mujoco>"""


def fall(seed: int, damping: dict[str, float], begins_s: float) -> Log:
    """A log of the fall; knees that are damped are so from a time on, in which the second segment begins."""
    rng = np.random.default_rng(seed)
    believed, true = (mujoco.MjModel.from_xml_string(model(of)) for of in ({}, damping))
    data, rows = mujoco.MjData(true), 500
    time = np.arange(rows) * PERIOD_S
    wanted = 0.5 * np.sin(2 * np.pi * (1.5 + 0.2 * seed) * time)[:, None] * np.ones(8)
    qpos, qvel = np.empty((rows, true.nq)), np.empty((rows, true.nv))
    for row in range(rows):
        qpos[row], qvel[row] = data.qpos, data.qvel
        for _ in range(2):
            data.ctrl[:] = KP * (wanted[row] - data.qpos[7:]) - KD * data.qvel[6:]
            mujoco.mj_step(true if time[row] >= begins_s else believed, data)
    columns = {"time": time}
    names = ("base_pos_x", "base_pos_y", "base_pos_z", "base_quat_w", "base_quat_x", "base_quat_y", "base_quat_z")
    rates = (*(f"base_linvel_{a}" for a in "xyz"), *(f"base_angvel_{a}" for a in "xyz"))
    columns |= {name: qpos[:, k].copy() for k, name in enumerate(names)}
    columns |= {name: qvel[:, k] + 0.01 * rng.standard_normal(rows) for k, name in enumerate(rates)}
    for k, joint in enumerate(JOINTS):
        columns |= {
            f"joint_pos/{joint}": qpos[:, 7 + k] + 3e-4 * rng.standard_normal(rows),
            f"joint_vel/{joint}": qvel[:, 6 + k] + 0.02 * rng.standard_normal(rows),
            f"cmd_pos/{joint}": wanted[:, k].copy(),
            f"cmd_vel/{joint}": np.zeros(rows),
            f"cmd_tau/{joint}": np.zeros(rows),
            f"cmd_kp/{joint}": np.full(rows, KP),
            f"cmd_kd/{joint}": np.full(rows, KD),
        }
    segments = (Segment("before", 0.0, begins_s), Segment("after", begins_s, np.inf))
    return Log(f"fall_{seed}", columns, LogInfo("four", PERIOD_S, "plain MuJoCo", stated_segments=segments))


@pytest.fixture(scope="module")
def four(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    path = tmp_path_factory.mktemp("four") / "four.xml"
    path.write_text(model({}))
    return Robot.load(path)


def mapped(robot: Robot, damping: dict[str, float]) -> list[Place]:
    logs = [fall(seed, damping, 0.4) for seed in range(4)]
    return localise(JudgedLogs.of(logs, robot), Replayer(robot), 0.1, 3, np.random.default_rng(1))


def test_the_pairs_of_this_robot_are_known(four: Robot) -> None:
    assert four.topology.sides["FR_knee"] == four.topology.sides["FL_knee"]


def test_left_and_right_are_one_where_both_are_damped(four: Robot) -> None:
    found = mapped(four, {"FL": 0.1, "FR": 0.1})
    knees = [place for place in found if place.phase == "after" and place.channel == "joint_vel/FL_knee"]
    (left,) = knees
    (right,) = (p for p in found if p.phase == "after" and p.channel == "joint_vel/FR_knee")
    assert left.as_one_with == "joint_vel/FR_knee" and right.as_one_with == "joint_vel/FL_knee"
    assert left.share == right.share
    assert left.share + right.share > 0.2


def test_left_and_right_are_told_apart_where_one_is_damped(four: Robot) -> None:
    found = mapped(four, {"FL": 0.1})
    by_place = {(place.phase, place.channel): place for place in found}
    left, right = (by_place["after", f"joint_vel/{leg}_knee"] for leg in ("FL", "FR"))
    assert left.as_one_with is None and right.as_one_with is None
    assert left.share > 10 * right.share
    assert found[0].channel.endswith("FL_knee") and found[0].phase == "after"


def test_shares_lie_within_their_intervals_and_add_up(four: Robot) -> None:
    found = mapped(four, {"FL": 0.1, "RR": 0.05})
    assert sum(place.share for place in found) == pytest.approx(1)
    assert all(0 <= place.share_ci95[0] <= place.share <= place.share_ci95[1] <= 1 for place in found)
    before = sum(place.share for place in found if place.phase == "before")
    assert before < 0.05, "nothing acts before 0.4 s"


def test_logs_that_agree_give_narrow_intervals_and_logs_that_do_not_wide_ones() -> None:
    rng = np.random.default_rng(0)
    noise = np.full((3, 4, 1, 2), 1e-3)
    alike, unlike = np.full((4, 1, 2), 50.0), np.array([[[100.0, 0.0]], [[0.0, 100.0]]] * 2)
    narrow, wide = (Shares.of(squares, noise, rng) for squares in (alike, unlike))
    assert narrow.value == pytest.approx(0.5) and wide.value == pytest.approx(0.5)
    assert (narrow.high - narrow.low).max() < 1e-6
    assert (wide.high - wide.low).min() > 0.5
