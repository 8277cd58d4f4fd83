"""Motion of the planar rigid body, which tests compare with models and controllers."""

import numpy as np

from leapgap.jumping.models.rigid_body import GRAVITY, RigidBody, advance


def acceleration(body: RigidBody, foot: np.ndarray, force: np.ndarray) -> np.ndarray:
    """(v̇x, v̇z, ω̇), shape (…, 3), under ground forces on the robot, front x z, rear x z, N, (…, 4)."""
    found = np.einsum("...ij,...j->...i", body.force_rows(foot), force)
    found[..., 1] -= GRAVITY
    return found


def step(
    body: RigidBody, state: np.ndarray, foot: np.ndarray, force: np.ndarray, step_s: np.ndarray | float
) -> np.ndarray:
    """x⁺ = (I + A Δt) x + B(r) Δt u (paper, nominal step): states (…, 6) one step of ``step_s`` (…) later."""
    return advance(state, acceleration(body, foot, force), step_s)
