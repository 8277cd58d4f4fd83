import mujoco
import numpy as np
import pytest

from leapgap.jumping.models.rigid_body import PUBLISHED, RigidBody, advance
from tests.jumping.rigid_motion import acceleration, step

BODY = RigidBody(mass_kg=10.0, pitch_inertia_kgm2=0.5)


def test_a_step_computed_by_hand():
    state = np.array([1.0, 0.3, 0.1, 0.5, -0.2, 0.4])
    foot = np.array([0.2, -0.3, -0.2, -0.25])
    force = np.array([5.0, 60.0, -10.0, 80.0])
    moment = (-0.3 * 5 - 0.2 * 60) + (-0.25 * -10 - -0.2 * 80)  # -13.5 + 18.5 = 5
    expected = [
        1.0 + 0.025 * 0.5,
        0.3 - 0.025 * 0.2,
        0.1 + 0.025 * 0.4,
        0.5 + 0.025 * -5 / 10,
        -0.2 + 0.025 * (140 / 10 - 9.81),
        0.4 + 0.025 * moment / 0.5,
    ]
    np.testing.assert_allclose(step(BODY, state, foot, force, 0.025), expected, rtol=1e-12)


@pytest.mark.parametrize("force", [(30.0, 0.0), (0.0, 100.0), (20.0, -50.0)])
def test_acceleration_agrees_with_mujoco(force):
    """A free box pushed off its centre: pitch is MuJoCo's rotation about +y, nose-down."""
    model = mujoco.MjModel.from_xml_string("""
      <mujoco><worldbody><body><freejoint/>
        <inertial pos="0 0 0" mass="10" diaginertia="0.2 0.5 0.6"/><geom size="0.1" mass="0"/>
      </body></worldbody></mujoco>""")
    data = mujoco.MjData(model)
    foot = np.array([0.2, -0.3])
    mujoco.mj_forward(model, data)
    mujoco.mj_applyFT(
        model,
        data,
        np.array([force[0], 0, force[1]]),
        np.zeros(3),
        np.array([foot[0], 0, foot[1]]),
        1,
        data.qfrc_applied,
    )
    mujoco.mj_forward(model, data)
    ours = acceleration(BODY, np.array([*foot, 0.0, 0.0]), np.array([*force, 0.0, 0.0]))
    np.testing.assert_allclose(ours, data.qacc[[0, 2, 4]], atol=1e-9)
    nose_down = np.zeros(9)
    mujoco.mju_quat2Mat(nose_down, np.array([np.cos(0.05), 0, np.sin(0.05), 0]))
    assert nose_down.reshape(3, 3)[2, 0] < 0  # a positive turn about y lowers what points forward


def test_force_rows_are_the_gradient_of_the_acceleration():
    random = np.random.default_rng(0)
    foot, force = random.normal(size=(5, 4)), random.normal(size=(5, 4))
    for i in range(4):
        bump = np.eye(4)[i] * 1e-3
        slope = (acceleration(BODY, foot, force + bump) - acceleration(BODY, foot, force - bump)) / 2e-3
        np.testing.assert_allclose(BODY.force_rows(foot)[..., i], slope, atol=1e-9)


def test_momentum_without_force_and_free_fall():
    state = np.array([[0.0, 1.0, 0.0, 2.0, 0.0, 3.0]])
    after = step(BODY, state, np.zeros((1, 4)), np.zeros((1, 4)), np.array([0.1]))
    np.testing.assert_allclose(after, [[0.2, 1.0, 0.3, 2.0, -0.981, 3.0]])


def test_infinite_inertia_drops_the_moment():
    pushed = acceleration(RigidBody(10.0, np.inf), np.array([0.2, -0.3, 0, 0]), np.array([5.0, 60, 0, 0]))
    assert pushed[2] == 0


def test_a_step_changes_neither_its_arguments_nor_their_shape():
    state = np.ones((3, 2, 6))
    after = advance(state, np.ones((3, 2, 3)), np.full((3, 2), 0.1))
    assert after.shape == state.shape and (state == 1).all()
    assert RigidBody(12.0, 0.17) == PUBLISHED


def test_with_curvature_a_half_free_fall_is_exact_whatever_the_step():
    state = np.array([0.0, 1.0, 0.0, 0.5, 2.0, 0.0])
    fall = np.array([0.0, -9.81, 0.0])
    coarse = advance(state, fall, 0.4, 0.5)
    fine = state
    for _ in range(40):
        fine = advance(fine, fall, 0.01, 0.5)
    assert coarse == pytest.approx(fine, abs=1e-12)
    assert coarse[1] == pytest.approx(1.0 + 2.0 * 0.4 - 9.81 * 0.4**2 / 2)
    assert advance(state, fall, 0.4)[1] == pytest.approx(1.0 + 2.0 * 0.4)  # as published
