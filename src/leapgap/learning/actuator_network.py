"""Actuator networks: a history of position errors and velocities in, torque out, one network for each joint group.

They are the learned rivals of named causes, and are judged beside them on logs they were not trained on. Input and
output are those of ``ActuatorNetMLP`` (Isaac Lab) and ``LearnedMlpActuator`` (mjlab): errors, newest first, then
velocities, each times a scale; the output times a scale is the torque.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import nn

from leapgap.diagnosis.outside_forces.model_errors import Instants, inverse_dynamics, without_constraints
from leapgap.effects.base import Commands, Effect, ForceContext
from leapgap.errors import InputError
from leapgap.logs.derivatives import velocity_fit
from leapgap.logs.log import Log
from leapgap.logs.state import motion_of
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import write_json, write_text
from leapgap.simulation.rollout import joint_commands

WINDOW_S = 0.03  # window in which velocities are differenced to accelerations


@dataclass(frozen=True)
class ActuatorLog:
    """One log at the steps of a network, (steps, joints) each unless said."""

    log: Log
    robot: Robot
    rows: np.ndarray  # rows of the log, (steps,)
    step_s: float
    is_measured: bool  # whether the torque is the log's own; else inverse dynamics tells it

    @staticmethod
    def of(log: Log, robot: Robot, step_s: float, is_measured: bool) -> "ActuatorLog":
        """Every row that a step takes; the first and last windows, whose accelerations are poor, are left out."""
        period = log.info.sample_period_s
        every, margin = max(1, round(step_s / period)), max(1, round(WINDOW_S / period))
        rows = np.arange(margin, len(log) - margin, every)
        return ActuatorLog(log, robot, rows, every * period, is_measured)

    @cached_property
    def at(self) -> ForceContext:
        """The motion with its commands, as effects read it."""
        robot, log = self.robot, self.log
        motion, sent = (
            motion_of(log, robot),
            [joint_commands(log, robot, name) for name in ("cmd_tau", "cmd_pos", "cmd_vel")],
        )
        acceleration = velocity_fit(log.time, motion.qvel, WINDOW_S).velocity
        kp, kd = (joint_commands(log, robot, name)[self.rows] for name in ("cmd_kp", "cmd_kd"))
        own = (motion.qpos[self.rows], motion.qvel[self.rows], acceleration[self.rows])
        commands = Commands(*(one[self.rows] for one in sent))
        return ForceContext(robot, robot.model, *own, commands, kp, kd, self.step_s)

    @cached_property
    def torque(self) -> np.ndarray:
        """Torque at the joints beside the feed-forward, N·m: the log's, or what the motion needs of the nominal model.

        The latter holds the dry friction of the gears, which the model is rid of, and not its damping.
        """
        if self.is_measured:
            found = self.log.per_joint("tau", self.robot.joints)[self.rows]
        else:
            at, none = self.at, np.zeros_like(self.at.qvel)
            motion = Instants(self.log.time[self.rows], at.qpos, at.qvel, at.qacc, none, none)
            found = inverse_dynamics(without_constraints(self.robot.model), motion)[:, self.robot.joint_dofs]
        return np.asarray(found - self.at.commands.torque)

    @cached_property
    def joint_pd(self) -> np.ndarray:
        """What the joint PD asks for within the limits, beside the feed-forward, N·m."""
        return np.asarray(self.at.torque - self.at.commands.torque)

    def with_causes(self, causes: Sequence[Effect]) -> np.ndarray:
        """The same with what named causes add, to first order, N·m."""
        found = self.joint_pd.copy()
        for effect in causes:
            force = type(effect).force(self.at, effect.location)
            if force is None:
                continue
            for one, by in zip(effect.parameters(self.robot, effect.location), force, strict=True):
                found += (effect.values.get(one.name, one.nominal) - one.nominal) * by[:, self.robot.joint_dofs]
        return found

    def inputs(self, joint: int, history: int) -> np.ndarray:
        """Position errors, newest first, then velocities likewise, (steps − history + 1, 2 history)."""
        columns = [
            values[history - 1 - lag : len(values) - lag, joint]
            for values in (self.at.commands.position - self.at.position, self.at.velocity)
            for lag in range(history)
        ]
        return np.stack(columns, axis=1)


def actuator_logs(logs: Sequence[Log], robot: Robot, step_s: float) -> list[ActuatorLog]:
    """Logs at the steps of a network; ``InputError`` where no torque can be told, or gains differ."""
    if len(logs) < 2:
        expected = "two or more: a network is judged on logs it was not trained on"
        raise InputError("actuator-net", f"{len(logs)} log", expected, "log another motion")
    is_measured = all(f"tau/{joint}" in log for log in logs for joint in robot.driven_joints)
    if robot.has_free_base and not is_measured:
        expected = "measured torques (tau/<joint>): contacts hide what the joints of a floating robot feel"
        raise InputError(logs[0].name, "no torque", expected, "log them, or hang the robot up")
    found = [ActuatorLog.of(log, robot, step_s, is_measured) for log in logs]
    if short := [one.log for one in found if not len(one.rows)]:
        says = f"{len(short[0])} rows of {short[0].info.sample_period_s:g} s"
        raise InputError(short[0].name, says, f"more than {2 * WINDOW_S:g} s", "leave it out, or log more")
    gains = np.concatenate([np.hstack([one.at.kp, one.at.kd]) for one in found])
    if np.ptp(gains, axis=0).max() > 1e-6 * np.abs(gains).max():
        expected = "the same gains in all logs: a network stands in the place of one joint PD"
        raise InputError("actuator-net", "gains that change", expected, "take logs of one set of gains")
    return found


HISTORY, STEP_S = 3, 0.005  # steps of history, and their length: the physics step at which the network is to run
WIDTH, EPOCHS, RATE = 32, 300, 0.01
FOLDS = 4
UNLIMITED = 1e6  # limit of torque and speed that stands for none
OPSET, IR_VERSION = 18, 10
SOURCE = '''\
"""Actuator networks of a robot: `ACTUATORS` for {library}. They run at physics steps of {step_s:g} s.

{friction}
"""

from pathlib import Path

from {module} import {config}

HERE = Path(__file__).parent
ACTUATORS = {{
{entries}
}}
'''


@dataclass(frozen=True)
class NetworkErrors:
    """Errors of the torque of one group on logs that were not fitted on, root mean square, N·m."""

    joints: tuple[str, ...]
    torque: float  # of the torque itself
    joint_pd: float  # of the joint PD as the log and model have it
    named_causes: float | None  # with the causes of a report; None without one
    network: float


@dataclass(frozen=True)
class ActuatorNetwork:
    """The trained network of one group with its scales."""

    layers: nn.Sequential
    history: int
    pos_scale: float
    vel_scale: float
    torque_scale: float

    @staticmethod
    def train(inputs: np.ndarray, torque: np.ndarray, seed: int) -> "ActuatorNetwork":
        """From inputs (rows, 2 history) and torques (rows,)."""
        history = inputs.shape[1] // 2
        position, velocity, size = (
            1 / max(float(np.sqrt((one**2).mean())), 1e-9) for one in (inputs[:, :history], inputs[:, history:], torque)
        )
        scales = np.repeat([position, velocity], history)
        scaled = torch.tensor(inputs * scales, dtype=torch.float32)
        wanted = torch.tensor(torque[:, None] * size, dtype=torch.float32)
        torch.manual_seed(seed)
        hidden = [nn.Linear(2 * history, WIDTH), nn.Softsign(), nn.Linear(WIDTH, WIDTH), nn.Softsign()]
        layers = nn.Sequential(*hidden, nn.Linear(WIDTH, 1))
        adam = torch.optim.Adam(layers.parameters(), lr=RATE)
        rate = torch.optim.lr_scheduler.CosineAnnealingLR(adam, EPOCHS)
        for _ in range(EPOCHS):  # all rows at once, with a rate that falls to zero
            adam.zero_grad()
            nn.functional.mse_loss(layers(scaled), wanted).backward()
            adam.step()
            rate.step()
        return ActuatorNetwork(layers.eval(), history, position, velocity, 1 / size)

    @property
    def scales(self) -> np.ndarray:
        """Of the inputs, (2 history,)."""
        return np.repeat([self.pos_scale, self.vel_scale], self.history)

    def torque(self, inputs: np.ndarray) -> np.ndarray:
        """Torque for inputs (rows, 2 history), N·m, (rows,)."""
        with torch.inference_mode():
            found = self.layers(torch.tensor(inputs * self.scales, dtype=torch.float32))
        return np.asarray(found.numpy()[:, 0] * self.torque_scale, dtype=float)

    def write_torchscript(self, path: Path) -> None:
        """The network without its scales, as the simulators read it."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            torch.jit.trace(self.layers, torch.zeros(1, 2 * self.history)).save(str(path))

    def write_onnx(self, path: Path) -> None:
        """The same without TorchScript: ``input`` (n, 2 history) to ``output`` (n, 1)."""
        nodes, constants, last = [], [], "input"
        for k, layer in enumerate(self.layers):
            out = "output" if k == len(self.layers) - 1 else f"value_{k}"
            names = [last]
            if isinstance(layer, nn.Linear):
                for part in ("weight", "bias"):
                    names.append(f"{part}_{k}")
                    constants.append(numpy_helper.from_array(getattr(layer, part).detach().numpy(), names[-1]))
                nodes.append(helper.make_node("Gemm", names, [out], transB=1))
            else:
                nodes.append(helper.make_node("Softsign", names, [out]))
            last = out
        ends = [
            [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", size])]
            for name, size in (("input", 2 * self.history), ("output", 1))
        ]
        graph = helper.make_graph(nodes, "actuator", *ends, initializer=constants)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)
        onnx.checker.check_model(model)
        path.write_bytes(model.SerializeToString(deterministic=True))


@dataclass(frozen=True)
class ActuatorNetworks:
    """The networks of all groups with their errors."""

    networks: dict[str, ActuatorNetwork]
    errors: dict[str, NetworkErrors]
    robot: Robot
    step_s: float
    is_measured: bool
    left_out: tuple[str, ...]  # causes of the report whose torque is not known in closed form

    def __str__(self) -> str:
        """A table for a person."""
        told = "measured torque" if self.is_measured else "torque by inverse dynamics"
        lines = [f"errors of the {told} on logs not trained on, N·m rms, steps of {self.step_s:g} s:"]
        lines.append(f"{'group':<16} {'torque':>9} {'joint PD':>9} {'causes':>9} {'network':>9}")
        for group, one in self.errors.items():
            causes = "-" if one.named_causes is None else f"{one.named_causes:.3f}"
            lines.append(f"{group:<16} {one.torque:9.3f} {one.joint_pd:9.3f} {causes:>9} {one.network:9.3f}")
        if self.left_out:
            lines.append(f"'causes' is without {', '.join(self.left_out)}, of which no torque is known")
        return "\n".join(lines)

    def write(self, folder: Path) -> None:
        """Networks, what mjlab and Isaac Lab need to load them, and the errors."""
        folder.mkdir(parents=True, exist_ok=True)
        for group, network in self.networks.items():
            network.write_torchscript(folder / f"{group}.pt")
            network.write_onnx(folder / f"{group}.onnx")
        write_text(folder / "for_mjlab.py", self.source("mjlab 1.6", "mjlab.actuator", "LearnedMlpActuatorCfg"))
        write_text(folder / "for_isaac_lab.py", self.source("Isaac Lab 2", "isaaclab.actuators", "ActuatorNetMLPCfg"))
        errors = {group: asdict(one) for group, one in self.errors.items()}
        write_json(folder / "errors.json", {"unit": "N·m", "step_s": self.step_s, "groups": errors})

    def source(self, library: str, module: str, config: str) -> str:
        """Python for one of the libraries."""
        of_mjlab, entries = module.startswith("mjlab"), []
        for group, network in self.networks.items():
            joints = self.errors[group].joints
            limit = max(float(self.robot.torque_limits[self.robot.joints.index(joint)]) for joint in joints)
            limit = limit if np.isfinite(limit) else UNLIMITED
            names = "target_names_expr" if of_mjlab else "joint_names_expr"
            history = "history_length" if of_mjlab else "input_idx"
            values = {
                names: joints if of_mjlab else list(joints),
                "effort_limit": limit,
                "saturation_effort": limit,
                "velocity_limit": UNLIMITED,
                "pos_scale": network.pos_scale,
                "vel_scale": network.vel_scale,
                "torque_scale": network.torque_scale,
                "input_order": "pos_vel",
                history: network.history if of_mjlab else list(range(network.history)),
            }
            if of_mjlab and not self.is_measured:
                values["frictionloss"] = 0.0
            file = f'        network_file=str(HERE / "{group}.pt"),'
            own = "\n".join(f"        {key}={value!r}," for key, value in values.items())
            entries.append(f'    "{group}": {config}(\n{own}\n{file}\n    ),')
        friction = "The dry friction of the joints is in the networks: set that of the model to zero."
        if self.is_measured:
            friction = "Friction of the gears that the measured torque does not hold stays in the model."
        inserted = {"library": library, "module": module, "config": config, "step_s": self.step_s}
        return SOURCE.format(**inserted, friction=friction, entries="\n".join(entries))


def train_networks(
    logs: Sequence[Log],
    robot: Robot,
    causes: Sequence[Effect] | None = None,
    history: int = HISTORY,
    step_s: float = STEP_S,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> ActuatorNetworks:
    """Train a network for each joint group, and judge it on held-out logs beside the joint PD and named causes."""
    read = actuator_logs(logs, robot, step_s)
    groups = {name: robot.joints_at(name) for name in robot.joint_groups} or {
        name: robot.joints_at(name) for name in robot.joints
    }
    groups = {name: at[robot.driven[at]] for name, at in groups.items()}
    fold = np.arange(len(read)) % min(FOLDS, len(read))
    networks, errors = {}, {}
    groups = {name: at for name, at in groups.items() if len(at)}
    for step, (group, joints) in enumerate(groups.items(), start=1):
        progress(f"step {step} of {len(groups)}, network of {group}: {', '.join(robot.joints[j] for j in joints)}")
        data = [samples(one, joints, history) for one in read]
        missed = []
        for k in np.unique(fold):
            network = ActuatorNetwork.train(*joined([data[i] for i in np.flatnonzero(fold != k)]), seed)
            missed += [network.torque(data[i][0]) - data[i][1] for i in np.flatnonzero(fold == k)]
        networks[group] = ActuatorNetwork.train(*joined(data), seed)
        errors[group] = NetworkErrors(
            tuple(robot.joints[j] for j in joints),
            rms([torque for _, torque in data]),
            rms([(one.joint_pd - one.torque)[history - 1 :, joints] for one in read]),
            None
            if causes is None
            else rms([(one.with_causes(causes) - one.torque)[history - 1 :, joints] for one in read]),
            rms(missed),
        )
    left_out = tuple(e.name for e in causes or () if type(e).force(read[0].at, e.location) is None)
    return ActuatorNetworks(networks, errors, robot, read[0].step_s, read[0].is_measured, left_out)


def samples(of: ActuatorLog, joints: np.ndarray, history: int) -> tuple[np.ndarray, np.ndarray]:
    """Inputs and torques of some joints of a log, joint by joint."""
    inputs = np.concatenate([of.inputs(int(joint), history) for joint in joints])
    return inputs, np.concatenate([of.torque[history - 1 :, joint] for joint in joints])


def joined(parts: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Inputs and torques of several logs."""
    return np.concatenate([inputs for inputs, _ in parts]), np.concatenate([torque for _, torque in parts])


def rms(of: Sequence[np.ndarray]) -> float:
    """Root mean square of all numbers."""
    return float(np.sqrt((np.concatenate([one.ravel() for one in of]) ** 2).mean()))
