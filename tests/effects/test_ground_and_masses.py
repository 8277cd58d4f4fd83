"""Effects at ground, air and masses against statics and closed forms."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.robot.terrain import Box
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from tests.conftest import standing

G = 9.81


def simulate_standing(
    robot: Robot, jump: Log, *found: effects.Effect, lift_m: float = 0.0
) -> tuple[mujoco.MjData, Motion]:
    """The robot after it has stood for the length of the jump: solved contacts, and its motion."""
    replayer, trial = Replayer(robot), Rollout(jump, found)
    start = replayer.first_state(trial)
    start[2] += lift_m
    (motion,) = replayer.true_motions([replace(trial, first_state=start)])
    model = replayer.model(trial)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = motion.qpos[-1], motion.qvel[-1]
    data.ctrl[:] = replayer._controls(trial, len(jump))[-1]
    mujoco.mj_forward(model, data)
    return data, motion


def foot_forces(robot: Robot, data: mujoco.MjData) -> np.ndarray:
    """Ground force on each foot in world axes, N, (feet, 3)."""
    total, force = np.zeros((len(robot.feet), 3)), np.zeros(6)
    for i, contact in enumerate(data.contact):
        mujoco.mj_contactForce(data.model, data, i, force)
        names = [data.model.geom(g).name for g in contact.geom]
        foot = next(name for name in names if name in robot.feet)
        sign = 1.0 if names[1] == foot else -1.0  # the frame's x axis points from the first geom to the second
        total[robot.feet.index(foot)] += sign * contact.frame.reshape(3, 3).T @ force[:3]
    return total


@pytest.mark.parametrize("mu", [0.2, 0.4])
def test_feet_slide_at_the_cone_of_their_friction(robot: Robot, mu: float) -> None:
    """Thrown forward over the floor, each foot's tangential force is mu times its normal force."""
    jump = standing(robot, 20)
    thrown = Log("thrown", dict(jump.columns) | {"base_linvel_x": np.full(20, 1.0)}, jump.info)
    data, _ = simulate_standing(robot, thrown, effects.effect("foot_friction", mu=mu))
    force = foot_forces(robot, data)
    bearing = force[:, 2] > 5
    assert bearing.sum() >= 2
    assert np.linalg.norm(force[bearing, :2], axis=1) / force[bearing, 2] == pytest.approx(mu, rel=0.02)
    assert (force[bearing, 0] < 0).all()


def test_friction_and_compliance_hold_at_the_named_feet_only(robot: Robot) -> None:
    found = (
        effects.effect("foot_friction", location="RR", mu=0.3),
        effects.effect("foot_compliance", location="front", time_constant_s=0.06),
    )
    data, _ = simulate_standing(robot, standing(robot, 100), *found)
    by_foot = {data.model.geom(int(max(c.geom))).name: c for c in data.contact}
    assert {foot: c.friction[0] for foot, c in by_foot.items()} == {"FR": 0.8, "FL": 0.8, "RR": 0.3, "RL": 0.8}
    assert {foot: c.solref[0] for foot, c in by_foot.items()} == {"FR": 0.06, "FL": 0.06, "RR": 0.02, "RL": 0.02}


def test_a_soft_foot_sinks_by_the_square_of_its_time_constant(robot: Robot) -> None:
    """MuJoCo's contact is a spring of stiffness ∝ 1/T²: at rest under the same load depth grows with T²."""
    depth = {}
    for constant in (0.02, 0.04):
        data, _ = simulate_standing(
            robot, standing(robot, 1500), effects.effect("foot_compliance", time_constant_s=constant)
        )
        depth[constant] = -np.mean([c.dist for c in data.contact])
    assert depth[0.04] / depth[0.02] == pytest.approx(4, rel=0.15)


def test_named_feet_stand_higher_by_the_height_and_the_others_as_before(robot: Robot) -> None:
    """Contacts of the raised feet lie on the raised ground, on a stated block too, and bear the weight there."""
    jump = standing(robot, 1000)
    block = Box(0.18, 0.0, (0.2, 0.5, 0.02), 0.02)
    on_block = replace(jump, info=replace(jump.info, terrain=(block,)))
    for stated, top in ((jump, 0.0), (on_block, 0.02)):
        raised = effects.effect("ground_height", location="front", height_m=0.03)
        data, _ = simulate_standing(robot, stated, raised, lift_m=top + 0.03)
        heights: dict[str, list[float]] = {}
        for contact in data.contact:
            name = next(n for n in (data.model.geom(g).name for g in contact.geom) if n in robot.feet)
            heights.setdefault(name, []).append(contact.pos[2])
        for foot, height in heights.items():
            expected = top + 0.03 if foot[0] == "F" else 0.0
            assert height == pytest.approx([expected] * len(height), abs=1e-3)
        assert set(heights) == set(robot.feet)
        assert foot_forces(robot, data)[:, 2].sum() == pytest.approx(robot.total_mass * G, rel=0.02)


def test_a_hole_under_one_foot_is_no_hole_for_the_others(robot: Robot) -> None:
    hole = effects.effect("ground_height", location="RL", height_m=-0.05)
    data, _ = simulate_standing(robot, standing(robot, 1000), hole)
    soles = data.geom_xpos[[data.model.geom(f).id for f in robot.feet], 2] - robot.foot_radius
    assert soles[[1, 2]] == pytest.approx(0, abs=3e-3)  # it stands on this diagonal and leans into the hole
    assert soles[3] < -0.01


@pytest.mark.parametrize("pitch", [0.05, -0.05])
def test_on_a_slope_the_floor_pushes_back_along_its_normal(robot: Robot, pitch: float) -> None:
    """Positive falls away forward. At rest friction is the weight's share along the slope, and vertical is vertical."""
    slope = effects.effect("ground_slope", pitch_rad=pitch)
    data, motion = simulate_standing(robot, standing(robot, 1500), slope, lift_m=0.02)
    heights = {data.model.geom(int(max(c.geom))).name: c.pos[2] for c in data.contact}
    positions = {data.model.geom(int(max(c.geom))).name: c.pos[0] for c in data.contact}
    assert set(heights) == set(robot.feet)
    for foot, height in heights.items():
        assert height == pytest.approx(-np.tan(pitch) * positions[foot], abs=1e-3)
    normal = data.contact[0].frame[:3] * np.sign(data.contact[0].frame[2])
    assert normal == pytest.approx([np.sin(pitch), 0, np.cos(pitch)], abs=1e-9)
    assert foot_forces(robot, data).sum(axis=0) == pytest.approx([0, 0, robot.total_mass * G], abs=1.5)
    assert np.abs(motion.qvel[-1]).max() < 0.05


def test_a_block_turns_with_the_slope_it_stands_on(robot: Robot) -> None:
    jump = standing(robot, 10)
    block = Box(0.5, 0.0, (0.2, 0.5, 0.1), 0.1)
    trial = Rollout(
        replace(jump, info=replace(jump.info, terrain=(block,))), (effects.effect("ground_slope", pitch_rad=0.08),)
    )
    model = Replayer(robot).model(trial)
    c, s = np.cos(0.08), np.sin(0.08)
    centre = 0.1 - model.geom("terrain_0").size[2]  # over the level floor
    assert model.geom("terrain_0").pos == pytest.approx([0.5 * c + centre * s, 0, -0.5 * s + centre * c])


def falling(robot: Robot, rows: int, velocity: tuple[float, float, float]) -> Log:
    jump = standing(robot, rows, height_m=50.0)
    names = ("base_linvel_x", "base_linvel_y", "base_linvel_z")
    return Log(
        "air", dict(jump.columns) | {n: np.full(rows, v) for n, v in zip(names, velocity, strict=True)}, jump.info
    )


@pytest.mark.parametrize("velocity", [(2.0, 0.0, 0.0), (1.5, -1.0, 2.0), (0.0, 0.0, -6.0)])
def test_drag_is_quadratic_against_the_velocity_in_any_direction(
    robot: Robot, velocity: tuple[float, float, float]
) -> None:
    trial = Rollout(falling(robot, 3, velocity), (effects.effect("aerodynamic_drag", coefficient=1.7),))
    replayer = Replayer(robot)
    model = replayer.model(trial)
    data, state = mujoco.MjData(model), replayer.first_state(trial)
    data.qpos[:], data.qvel[:] = state[: model.nq], state[model.nq :]
    data.qvel[3:6] = 0.0
    mujoco.mj_forward(model, data)
    without = Replayer(robot).model(Rollout(trial.log))
    v = np.array(velocity)
    assert data.qfrc_fluid[:3] == pytest.approx(-1.7 * np.linalg.norm(v) * v, abs=1e-6)
    about_centre = data.qfrc_fluid[3:6] - np.cross(robot.model.body_ipos[1], data.qfrc_fluid[:3])
    assert about_centre == pytest.approx(0, abs=1e-6)
    assert np.abs(data.qfrc_fluid[6:]).max() < 1e-6
    assert model.body_mass.sum() == without.body_mass.sum()


def test_a_robot_falls_at_last_with_its_terminal_velocity(robot: Robot) -> None:
    """From rest v = v_t tanh(g t / v_t), v_t² = m g / c."""
    jump = falling(robot, 1500, (0.0, 0.0, 0.0))
    (motion,) = Replayer(robot).motions([Rollout(jump, (effects.effect("aerodynamic_drag", coefficient=8.0),))])
    terminal = np.sqrt(robot.total_mass * G / 8.0)
    exact = -terminal * np.tanh(G * np.arange(1500) * 0.001 / terminal)
    assert motion.qvel[:, 2] == pytest.approx(exact, rel=0.01, abs=0.05)


def test_leg_mass_adds_up_and_trunk_and_inertia_scale(robot: Robot) -> None:
    replayer, jump = Replayer(robot), standing(robot, 5)
    link_masses = 0.696 + 1.013 + 0.226
    for location, legs in (("all", 4), ("front", 2), ("RR", 1)):
        model = replayer.model(Rollout(jump, (effects.effect("leg_mass", location=location, scale=1.3),)))
        assert model.body_mass.sum() == pytest.approx(12.453 + 0.3 * legs * link_masses)
        assert model.body_subtreemass[1] == pytest.approx(model.body_mass.sum())
    model = replayer.model(Rollout(jump, (effects.effect("leg_mass", location="calf", scale=1.3),)))
    calf = model.body("RL_calf").id
    assert model.body_inertia[calf] == pytest.approx(1.3 * robot.model.body_inertia[calf])
    assert model.body_mass.sum() == pytest.approx(12.453 + 0.3 * 4 * 0.226)
    model = replayer.model(Rollout(jump, (effects.effect("trunk_inertia", scale=1.5),)))
    assert model.body_inertia[1] == pytest.approx(1.5 * robot.model.body_inertia[1])
    assert model.body_mass.sum() == pytest.approx(12.453)


def test_a_heavier_trunk_inertia_turns_slower_under_the_same_moment(robot: Robot) -> None:
    """The mass matrix about the pitch axis grows by the trunk's own share, half of 0.0378 kg·m²."""
    pitch = 4
    inertia = {}
    for scale in (1.0, 1.5):
        model = Replayer(robot).model(Rollout(standing(robot, 5), (effects.effect("trunk_inertia", scale=scale),)))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        inertia[scale] = full[pitch, pitch]
    assert inertia[1.5] - inertia[1.0] == pytest.approx(0.5 * 0.0377999)


def test_longer_legs_and_wider_hips_move_the_feet_by_as_much(robot: Robot) -> None:
    """With legs stretched straight down a foot is as much lower as its links are longer, and as far out as its hip."""

    def feet(*own: effects.Effect) -> np.ndarray:
        model = Replayer(robot).model(Rollout(standing(robot, 5), own))
        data = mujoco.MjData(model)
        data.qpos[3] = 1.0
        mujoco.mj_forward(model, data)
        return np.array([data.geom(name).xpos for name in robot.foot_geom_names])

    outward = np.sign(feet()[:, 0])
    for by in (0.01, -0.01):
        moved = feet(effects.effect("leg_geometry", hip_x_m=by)) - feet()
        assert moved == pytest.approx(np.column_stack([by * outward, np.zeros(4), np.zeros(4)]), abs=1e-12)
    for upper, lower in ((0.02, 0.005), (-0.02, 0.005)):
        moved = feet(effects.effect("leg_geometry", upper_m=upper, lower_m=lower)) - feet()
        assert moved == pytest.approx(np.tile([0, 0, -upper - lower], (4, 1)), abs=1e-12)


def test_a_shifted_centre_of_mass_shifts_the_load_between_the_feet(robot: Robot) -> None:
    """Moments about the rear feet: m_trunk g dx moves dx/span of the trunk's weight to the front pair."""
    jump = standing(robot, 1500)
    front, span = {}, None
    for shift in (0.0, 0.03):
        data, _ = simulate_standing(robot, jump, effects.effect("com_offset", x_m=shift))
        force = foot_forces(robot, data)
        front[shift] = force[:2, 2].sum()
        feet = {data.model.geom(int(max(c.geom))).name: c.pos[0] for c in data.contact}
        span = feet["FR"] - feet["RR"]
    assert front[0.03] - front[0.0] == pytest.approx(4.713 * G * 0.03 / span, rel=0.1)
    model = Replayer(robot).model(Rollout(jump, (effects.effect("com_offset", x_m=0.03, z_m=-0.02),)))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    nominal = mujoco.MjData(robot.model)
    mujoco.mj_resetDataKeyframe(robot.model, nominal, 0)
    mujoco.mj_forward(robot.model, nominal)
    moved = data.subtree_com[1] - nominal.subtree_com[1]
    assert moved == pytest.approx(np.array([0.03, 0, -0.02]) * 4.713 / 12.453)
    assert data.geom("trunk").xpos == pytest.approx(nominal.geom("trunk").xpos)
