"""Rotors that turn beside their joints, behind a spring or play: coordinates after those of the robot itself.

The model of Spong (Trans. ASME J. Dynamic Systems, Measurement and Control 109, 1987): a rotor, seen through its gear,
is an inertia J on an axis of its own. The motor turns it, and a spring couples it to the joint:

    J θ̈ = τ − k (θ − q),    joint torque k (θ − q)

In MuJoCo the rotor is a hinge in the world, the joint's armature is its inertia, and a fixed tendon between the two is
the spring, or, for play, has limits. Motors and their joint PD act on the rotor; the robot's own joints stay what a log
reports.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from leapgap.robot.model import Robot

PREFIX = "rotor of "
STIFFEST = 0.7
"""Natural frequency of rotor against link times the step of the simulation, for the stiffest spring; 2 is unstable, and
in other poses the frequency is higher."""
LIGHTEST = 1e-3  # least inertia of a link, as a share of that of joint and rotor together
DAMPING_RATIO = 0.02  # of rotor against link on their spring
TEETH_SOLREF, TEETH_SOLIMP = (0.003, 1.0), (0.95, 0.99, 0.001, 0.5, 2.0)
"""Impact of the teeth at an end of the play, as MuJoCo describes contacts."""
CARRIED_ROWS = 10  # rows of a stiff robot's motion by which a rotor's first twist and its rate are known
WEIGHTLESS = 1e-9  # mass and inertia of the rotor's body, kg, kg·m²; what it has beyond is the armature of its joint


def joints_with_rotors(robot: Robot, location: str) -> np.ndarray:
    """Indices of the joints at a location that have motors, and so may have rotors, (joints,)."""
    at = robot.joints_at(location)
    return np.asarray(at[robot.driven[at]])


def add_rotors(spec: mujoco.MjSpec, robot: Robot, joints: Sequence[int]) -> None:
    """Put rotors beside joints, by their indices among the robot's, and hand their motors over to them.

    A joint that has one already keeps it.
    """
    present = {joint.name for joint in spec.joints}
    motors = {actuator.name: actuator for actuator in spec.actuators}
    for i in joints:
        joint, name = robot.joints[i], PREFIX + robot.joints[i]
        if name in present:
            continue
        body = spec.worldbody.add_body()
        body.name, body.explicitinertial, body.mass, body.inertia = name, True, WEIGHTLESS, [WEIGHTLESS] * 3
        hinge = body.add_joint()
        hinge.name, hinge.type = name, mujoco.mjtJoint.mjJNT_HINGE
        # A new part has the defaults of its model file, so everything is set.
        hinge.armature, hinge.damping, hinge.frictionloss, hinge.stiffness = 0.0, [0.0] * 3, 0.0, [0.0] * 3
        hinge.limited = hinge.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
        motors[robot.model.actuator(robot.joint_actuators[i]).name].target = name
        spring = spec.add_tendon()
        spring.name = name
        spring.wrap_joint(joint, 1.0)
        spring.wrap_joint(name, -1.0)
        spring.springlength, spring.margin = [0.0, 0.0], 0.0
        spring.stiffness, spring.damping, spring.frictionloss, spring.armature = [0.0] * 3, [0.0] * 3, 0.0, 0.0
        spring.limited, spring.range = mujoco.mjtLimited.mjLIMITED_TRUE, [-1.0, 1.0]


def reduced_inertia(robot: Robot, joints: np.ndarray) -> np.ndarray:
    """Inertia of rotor and link as they swing against each other, J I / (J + I), kg·m², (joints,), in the model's pose.

    I is that of a link whose neighbours give way, with all rotors taken off: 1 / (M⁻¹)ᵢᵢ.
    """
    model, data = robot.model, mujoco.MjData(robot.model)
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    dofs = robot.joint_dofs[joints]
    rotor, whole = model.dof_armature[dofs], np.diag(mass)[dofs]
    links = mass - (1 - WEIGHTLESS) * np.diag(model.dof_armature)
    link = np.maximum(1 / np.diag(np.linalg.inv(links))[dofs], LIGHTEST * whole)
    return np.asarray(rotor * link / (rotor + link))


def mount_rotors(model: mujoco.MjModel, robot: Robot, joints: np.ndarray) -> np.ndarray:
    """Give rotors the armature of their joints, and return the indices of their tendons, without play or spring.

    Rotors that are mounted already stay as they are.
    """
    for i in joints:
        rotor, dof = model.joint(PREFIX + robot.joints[i]).dofadr[0], robot.joint_dofs[i]
        if model.dof_armature[rotor] > 0:
            continue
        own = robot.model.dof_armature[dof]
        model.dof_armature[rotor], model.dof_armature[dof] = own, max(model.dof_armature[dof] - own, 0.0)
        tendon = model.tendon(PREFIX + robot.joints[i]).id
        model.tendon_range[tendon] = 0.0
        model.tendon_solref_lim[tendon], model.tendon_solimp_lim[tendon] = TEETH_SOLREF, TEETH_SOLIMP
    # MuJoCo 4.0's Newton solver diverges with sparse matrices where limits couple several trees of bodies.
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return np.array([model.tendon(PREFIX + robot.joints[i]).id for i in joints], dtype=int)


def soften(model: mujoco.MjModel, robot: Robot, joints: np.ndarray, tendons: np.ndarray, compliance: float) -> None:
    """Add to the compliance, rad/(N·m), of the springs in place of hard teeth.

    The stiffest spring that the step resolves gives a least compliance, which enters as the root of squares: springs
    that are three times softer are right to 5 %.
    """
    inertia = reduced_inertia(robot, joints)
    least = 1 / (inertia * (STIFFEST / model.opt.timestep) ** 2)
    model.tendon_stiffness[tendons] = 1 / np.hypot(least, compliance)
    model.tendon_damping[tendons] = 2 * DAMPING_RATIO * np.sqrt(model.tendon_stiffness[tendons] * inertia)
    model.tendon_limited[tendons] = 0


def carried_torque(
    stiff: mujoco.MjModel, robot: Robot, states: np.ndarray, controls: np.ndarray, steps: int
) -> np.ndarray:
    """Torque that gears carry from rotors to joints of a robot without springs and play, and its rate.

    (states, 2, joints), N·m and N·m/s. That is what the motor gives less what its rotor takes to speed up, τ − J q̈: a
    line through the first ``CARRIED_ROWS`` rows of ``steps`` steps each from states (states, nq + nv) under controls
    (states, rows, actuators). Contacts may settle meanwhile, so the line is that of median slopes (Theil and Sen), and
    the torque is one that motors have.
    """
    data, nq, nv, dofs = mujoco.MjData(stiff), robot.model.nq, robot.model.nv, robot.joint_dofs
    sent = controls[:, :CARRIED_ROWS]
    torque = np.zeros((len(states), sent.shape[1], len(dofs)))
    for found, state, of_rows in zip(torque, states, sent, strict=True):
        mujoco.mj_resetData(stiff, data)
        data.qpos[:nq], data.qvel[:nv] = state[:nq], state[nq:]
        for row, control in zip(found, of_rows, strict=True):
            data.ctrl[:] = control
            mujoco.mj_step(stiff, data)
            row[:] = data.qfrc_actuator[dofs] - robot.model.dof_armature[dofs] * data.qacc[dofs]
            mujoco.mj_step(stiff, data, steps - 1)
    time = stiff.opt.timestep * steps * np.arange(sent.shape[1])
    early, late = np.triu_indices(len(time), 1)
    rate = np.zeros((len(states), len(dofs)))
    if len(early):
        rate = np.median((torque[:, late] - torque[:, early]) / (time[late] - time[early])[:, None], axis=1)
    first = np.median(torque - time[:, None] * rate[:, None], axis=1)
    return np.stack([np.clip(first, -robot.torque_limits, robot.torque_limits), rate], axis=1)


def rest_rotors(
    model: mujoco.MjModel, robot: Robot, states: np.ndarray, carried: np.ndarray, kp: np.ndarray
) -> np.ndarray:
    """Positions and velocities (states, model nq + nv) with rotors where they carry a torque, and follow its change.

    ``states`` (states, nq + nv) are those of the robot itself; ``carried`` (states, 2, joints) is the torque, N·m, and
    its rate, N·m/s, with rotors where the joints are, and ``kp`` (joints,) how much less their motors give as they
    turn, N·m/rad. Of that loss the joint feels the share I / (J + I), since the rotor is slower too.
    """
    nq, nv = robot.model.nq, robot.model.nv
    qpos, qvel = np.tile(model.qpos0, (len(states), 1)), np.zeros((len(states), model.nv))
    qpos[:, :nq], qvel[:, :nv] = states[:, :nq], states[:, nq:]
    names = {model.joint(j).name: j for j in range(model.njnt)}
    behind = np.array([i for i, joint in enumerate(robot.joints) if PREFIX + joint in names], dtype=int)
    shares = reduced_inertia(robot, behind) / robot.model.dof_armature[robot.joint_dofs[behind]]
    for i, share in zip(behind, shares, strict=True):
        rotor, spring = names[PREFIX + robot.joints[i]], model.tendon(PREFIX + robot.joints[i]).id
        stiffness = model.tendon_stiffness[spring] + share * kp[i]
        gives = 0.0 if model.tendon_limited[spring] else 1 / stiffness
        torque, rate = carried[:, :, i].T
        twist = np.sign(torque) * model.tendon_range[spring, 1] + gives * torque
        qpos[:, model.jnt_qposadr[rotor]] = qpos[:, robot.joint_qpos[i]] + twist
        qvel[:, model.jnt_dofadr[rotor]] = qvel[:, robot.joint_dofs[i]] + gives * rate
    return np.concatenate([qpos, qvel], axis=1)
