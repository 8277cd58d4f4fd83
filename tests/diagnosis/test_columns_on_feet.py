"""What effects do to a robot whose feet stand on the ground, beside plain MuJoCo with that effect alone."""

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.engine.intervals import Course, Intervals
from leapgap.diagnosis.engine.points import Bench
from leapgap.diagnosis.engine.responses import Columns, late_feedback
from leapgap.diagnosis.engine.search import Search
from leapgap.diagnosis.engine.verdict import by_parabolas, top
from leapgap.diagnosis.engine.whitening import Chunks, linearise
from leapgap.diagnosis.gap import HeldOutGap
from leapgap.diagnosis.hypotheses import list_hypotheses
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.settings import TOLERANCES
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from tests.diagnosis.pushed_robots import A1, JUMP_KD, JUMP_KP, quadruped_jump

KINDS = ("joint_damping", "torque_gain", "ground_slope", "gravity_direction", "frame_tilt")
JOINTS = ("FR_hip", "FR_thigh", "RL_calf")
PUSHES_OFF = slice(20, 33)
"""Intervals in which the robot stretches and all feet are on the ground."""
Change = Callable[[mujoco.MjModel], None]


@pytest.fixture(scope="module")
def standing() -> tuple[Course, Columns, np.ndarray]:
    """A jump's intervals, the columns about them, and that of a late joint PD."""
    robot = Robot.load(A1)
    judged = JudgedLogs.of([quadruped_jump(0, [])], robot, {})
    intervals = Intervals.of(judged.states, Replayer(robot, 1, 1), 0.01)
    none = [np.zeros((own.intervals, 2 * robot.model.nv)) for own in intervals.courses]
    intervals, linearisation = linearise(intervals, Chunks.of(intervals), none)
    hypotheses = list_hypotheses([effects.known()[name] for name in KINDS], robot, None)
    (late,) = late_feedback(intervals, linearisation)
    return intervals.courses[0], Columns.of(intervals, linearisation, hypotheses), late


def ends(own: Course, change: Change, scale: Callable[[list[str]], np.ndarray], held: int = 1) -> np.ndarray:
    """Velocities at the end of each interval by plain MuJoCo, (intervals, nv).

    ``scale`` is of the joints' torques, which are computed once in so many steps of 0.25 ms.
    """
    model = mujoco.MjModel.from_xml_path(str(A1))
    model.opt.timestep = 0.00025
    change(model)
    joints, found = [model.joint(j).name for j in range(1, model.njnt)], []
    wanted, speed = (own.states.log.per_joint(name, joints) for name in ("cmd_pos", "cmd_vel"))
    for k in range(own.intervals)[PUSHES_OFF]:
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = np.split(own.start_states[k], [model.nq])
        for row in range(own.rows[own.begins[k]], own.rows[own.begins[k] + 1]):
            for step in range(4):
                if step % held:
                    mujoco.mj_step(model, data)
                    continue
                torque = JUMP_KP * (wanted[row] - data.qpos[7:]) + JUMP_KD * (speed[row] - data.qvel[6:])
                data.qfrc_applied[6:] = scale(joints) * np.clip(torque, -33.5, 33.5)
                mujoco.mj_step(model, data)
        found.append(data.qvel.copy())
    return np.array(found)


def unchanged(model: mujoco.MjModel) -> None:
    """The model as it is."""


def alike(joints: list[str]) -> np.ndarray:
    """All torques as they are."""
    return np.ones(len(joints))


def test_torques_that_are_held_for_a_step_are_a_late_joint_pd(standing: tuple[Course, Columns, np.ndarray]) -> None:
    """By half a step in the mean, 0.5 ms beside 0.125 ms."""
    own, _, late = standing
    plain = (ends(own, unchanged, alike, held=4) - ends(own, unchanged, alike)) / 0.375e-3
    found = late[PUSHES_OFF, plain.shape[1] :]
    assert (plain * found).sum() > 0.9 * np.linalg.norm(plain) * np.linalg.norm(found)
    assert np.linalg.norm(found) == pytest.approx(np.linalg.norm(plain), rel=0.3)


@pytest.mark.parametrize("joint", JOINTS)
@pytest.mark.parametrize("kind", ["joint_damping", "torque_gain"])
def test_columns_of_one_joint_are_its_own(standing: tuple[Course, Columns, np.ndarray], kind: str, joint: str) -> None:
    """Feet that stand couple all joints: what all do together does not tell what one does."""
    own, columns, _ = standing

    def damp(model: mujoco.MjModel) -> None:
        if kind == "joint_damping":
            model.dof_damping[model.joint(joint).dofadr[0]] += 0.05

    def scale(joints: list[str]) -> np.ndarray:
        return np.where([kind == "torque_gain" and name == joint for name in joints], 1.02, 1.0)

    step = 0.05 if kind == "joint_damping" else 0.02
    plain = (ends(own, damp, scale) - ends(own, unchanged, alike)) / step
    (index,) = [i for i, key in enumerate(columns.keys) if (key.effect, key.place) == (kind, joint)]
    found = columns.values[0][PUSHES_OFF, plain.shape[1] :, index]
    cosine = (plain * found).sum() / np.linalg.norm(plain) / np.linalg.norm(found)
    assert cosine > 0.8  # columns hold over all states that are likely, and a foot may slip in some
    assert np.linalg.norm(found) == pytest.approx(np.linalg.norm(plain), rel=0.4)


def test_a_slope_is_a_turned_frame_and_gravity_that_is_turned_back(
    standing: tuple[Course, Columns, np.ndarray],
) -> None:
    """No foot is lifted or pressed into the ground by it."""
    columns = standing[1].values[0]
    at = {(key.effect, key.number): i for i, key in enumerate(standing[1].keys)}
    turned, gravity = columns[:, :, at["frame_tilt", 1]], columns[:, :, at["gravity_direction", 1]]
    assert columns[:, :, at["ground_slope", 0]] == pytest.approx(
        turned - gravity, rel=0.1, abs=0.02 * abs(turned).max()
    )


@pytest.mark.parametrize("exactly", [True, False])
def test_a_wrong_zero_changes_nothing_of_what_is_reported_in_the_air(exactly: bool) -> None:
    """The joint PD holds the reported angle, whatever the true one is: only weight and contacts tell them apart."""
    robot = Robot.load(A1)
    judged = JudgedLogs.of([quadruped_jump(0, [])], robot, {})
    hypotheses = list_hypotheses([effects.known()["encoder_bias"]], robot, None)
    bench = Bench(hypotheses, TOLERANCES, judged.states, Replayer(robot, 1, 1))
    nominal = bench.nominal()
    own, size = nominal.intervals.courses[0], 0.002
    zeros = [h for h in hypotheses if h.location in ("FR_thigh", "RL_calf")]
    sets = [(), *(((h, np.array([size])),) for h in zeros)]
    steps, _ = bench.missed_by(nominal.intervals, nominal.basis, sets, exactly)
    missed = steps[bench.chunks.valid]
    model = mujoco.MjModel.from_xml_path(str(A1))
    data, touches = mujoco.MjData(model), []
    for state in own.start_states:
        data.qpos[:], data.qvel[:] = np.split(state, [model.nq])
        mujoco.mj_forward(model, data)
        touches.append(data.ncon > 0)
    in_air = [k for k in range(3, own.intervals - 1) if not any(touches[k - 3 : k + 2])]  # the reference has settled
    assert len(in_air) > 10
    for k, h in enumerate(zeros, start=1):
        at = 6 + [model.joint(j).name for j in range(1, model.njnt)].index(h.location)
        assert abs(missed[in_air, at, k] - missed[in_air, at, 0]).max() < 0.01 * size


def test_a_motor_that_lags_gives_the_torque_of_before_where_an_interval_begins() -> None:
    """By plain MuJoCo with a lag of most of an interval: its replays by that lag meet the log, others do not."""
    robot = Robot.load(A1)
    judged = JudgedLogs.of([quadruped_jump(0, [], lag_s=0.008)], robot, {})
    nominal = Intervals.of(judged.states, Replayer(robot, 1, 1), 0.01)
    none = [np.zeros((own.intervals, 2 * robot.model.nv, 2 * robot.model.nv)) for own in nominal.courses]
    lag = effects.known()["motor_lag"](time_constant_s=0.008)  # type: ignore[call-arg]
    lagging = replace(nominal, acting=((lag,),))
    assert not lagging.has_memory(0, (lag,))
    missed = [np.abs(own.defects(none)[0][PUSHES_OFF, robot.model.nv + 6 :]).mean() for own in (nominal, lagging)]
    assert missed[1] < 0.2 * missed[0]


@pytest.mark.long
def test_commands_that_reach_one_leg_late_are_found_far_from_nominal() -> None:
    """By plain MuJoCo, 10 ms: drives are replayed at the places that are asked for; stance tells no feet apart."""
    robot = Robot.load(A1)
    judged = JudgedLogs.of([quadruped_jump(log, [], late="RR") for log in range(3)], robot, {})
    kinds = [effects.known()[name] for name in ("command_delay", "joint_damping", "position_gain", "velocity_gain")]
    bench = Bench(list_hypotheses(kinds, robot, None), TOLERANCES, judged.states, Replayer(robot, 1, 1))
    search = Search(bench, np.arange(3), lambda _: None)
    start = search.judge(bench.nominal())
    assert {h.location for (h, _), _ in search.far(start.point, ("all",))} == {"all"}
    h, numbers = search.far(start.point, ("all", "RR"))[0][1]
    assert h.label == "command_delay at RR"
    assert numbers == pytest.approx([0.01], rel=0.4)
    settled = search.settle(search.moved(start.point, ((h, numbers),)))
    assert settled.numbers == pytest.approx([0.01], rel=0.1)


def test_numbers_that_settled_elsewhere_come_back_by_parabolas_through_evidence_and_whole_logs() -> None:
    """By plain MuJoCo with a lag of 8 ms, from a lag 15 % too long."""
    robot, lag_s = Robot.load(A1), 0.008
    judged = JudgedLogs.of([quadruped_jump(log, [], lag_s=lag_s) for log in range(2)], robot, {})
    bench = Bench(list_hypotheses(["motor_lag"], robot, None), TOLERANCES, judged.states, Replayer(robot, 1, 1))
    search, rng = Search(bench, np.arange(2), lambda _: None), np.random.default_rng(0)
    gap = HeldOutGap.of(judged, bench.replayer, 2, 1, 100, rng)
    (h,) = (one for one in bench.hypotheses if one.location == "all")
    elsewhere = np.array([1.15 * lag_s])
    found = search.moved(bench.nominal(), ((h, elsewhere),))
    candidate = Candidate((h,), elsewhere, np.zeros((1, 1)), np.tile(elsewhere, (2, 1)))
    better = by_parabolas(candidate, search, found, gap)
    assert better.numbers == pytest.approx([lag_s], rel=0.04)
    assert better.fold_numbers[:, 0] == pytest.approx(better.numbers[0])


def test_how_well_a_top_is_known_follows_from_the_scatter_about_the_parabola() -> None:
    rng, at = np.random.default_rng(0), (-0.2, -0.13, -0.07, 0.0, 0.07, 0.13, 0.2)
    off = []
    for _ in range(300):
        found, sure = top(at, -50 * (np.array(at) - 0.05) ** 2 + 0.05 * rng.standard_normal(7))
        off.append((found - 0.05) * np.sqrt(sure))
    assert np.median(np.abs(off)) == pytest.approx(0.74, rel=0.2)  # of Student, four degrees of freedom
    assert top(at, np.square(at)) == (0.0, 0.0)
