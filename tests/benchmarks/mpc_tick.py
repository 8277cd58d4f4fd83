"""How long does an MPC update take, from the estimate to joint torques, beside a plain torch + numpy + OSQP version?

With networks of the paper's sizes (h 7-400-400-3, G 7-1000-1000-12, random orthogonal weights: time does not depend
on their values), on the states of logged jumps at 40 Hz, one thread. Versions take turns jump by jump, each of them
once untimed (a robot stands before it jumps, and its controller has long been running). The plain version
evaluates all networks in torch for the K samples at every update, multiplies the condensed matrices out as the paper
writes them, and solves with OSQP at its default tolerance, set up once and updated. Accuracy, N, is the largest
deviation of any force of a plan from the independent method of tests/jumping/control/test_qp.py. The compiled
versions need the extra ``compiled``; without it there is no row of them. Run as
``python -m tests.benchmarks.mpc_tick --json <file>``; on a shared machine only ratios of one run mean something.
"""

import os

os.environ["OMP_NUM_THREADS"] = "1"  # before NumPy and torch read it

import argparse
import contextlib
import gc
import math
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
import osqp
import torch
from scipy import sparse

from leapgap.atomic_io import write_json
from leapgap.jumping.control import compiler
from leapgap.jumping.control.gains import PhaseGains
from leapgap.jumping.control.horizon import Horizon, horizon
from leapgap.jumping.control.inference import ExportedModel, Perceptron, Phase
from leapgap.jumping.control.leg_kinematics import LegKinematics
from leapgap.jumping.control.mpc import ForcePlan, MpcConfig
from leapgap.jumping.control.mpc_controller import JumpMpc
from leapgap.jumping.control.qp import QpConfig
from leapgap.jumping.control.reference import Reference, StartFrame
from leapgap.jumping.learning.windows import Purpose, TimeGrid
from leapgap.jumping.models.affine_model import AffineModel, PredictionModel, Situation, columns, rows, selection
from leapgap.jumping.models.rigid_body import GRAVITY
from leapgap.jumping.task import ContactSchedule, schedule_of, target_of
from leapgap.logs import log as jump_log
from leapgap.logs.log import Log
from leapgap.logs.pair_force import FORCE_X, FORCE_Z, per_axis
from leapgap.logs.schema import BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY
from leapgap.robot.model import Robot
from leapgap.simulation.controller import StateEstimate
from tests.conftest import A1_BODY
from tests.jumping.control.test_qp import by_least_distance

INPUTS = ("x_from_start", "z_from_start", "pitch", "front_foot_x", "front_foot_z", "rear_foot_x", "rear_foot_z")
SELECT = selection(INPUTS)
PAPER = ((400, 400), (1000, 1000))
SMALL = ((64, 64), (64, 64))
GRIDS = {"k10": TimeGrid(0.025, 0.1, 10), "k22": TimeGrid(0.025, 0.025, 22)}
"""As in the paper: variable steps, and fixed ones that see the landing too."""
ROUNDS = 2
TINY_STATES = 4
"""States of the one jump of a run that only shows that it starts."""
PLAIN_WHERE_BARS_WERE_SET_US = 1708.0
"""Median of torch + OSQP with the paper's networks on the machine for which the bars were set in microseconds."""
LIKE_CONTROL = 0.01
"""Outputs this small keep the plans sensible."""
Layers = list[tuple[np.ndarray, np.ndarray]]


def layers(widths: tuple[int, ...], outputs: int, rng: np.random.Generator) -> Layers:
    """Random orthogonal weights (out, in) and zero biases, float32."""
    sizes = (len(INPUTS), *widths, outputs)
    made = []
    for before, after in pairwise(sizes):
        q, _ = np.linalg.qr(rng.normal(size=(max(before, after), min(before, after))))
        weight = (q if after >= before else q.T).astype(np.float32)
        made.append((np.ascontiguousarray(weight), np.zeros(after, np.float32)))
    return [*made[:-1], (LIKE_CONTROL * made[-1][0], made[-1][1])]


@dataclass(frozen=True)
class Weights:
    """Of h1 (contact), h2 (flight) and G1 (forces in contact)."""

    h1: Layers
    h2: Layers
    g1: Layers

    @staticmethod
    def of(widths: tuple[tuple[int, ...], tuple[int, ...]]) -> "Weights":
        rng = np.random.default_rng(0)
        return Weights(layers(widths[0], 3, rng), layers(widths[0], 3, rng), layers(widths[1], 12, rng))


def forward(net: Layers, x: np.ndarray) -> np.ndarray:
    """Tanh network in NumPy, (n, inputs) → (n, outputs)."""
    for weight, bias in net[:-1]:
        x = np.tanh(x @ weight.T + bias)
    return x @ net[-1][0].T + net[-1][1]


class Networks(PredictionModel):
    """Rigid body plus networks, in NumPy."""

    def __init__(self, weights: Weights) -> None:
        self.weights, self.body = weights, A1_BODY

    def affine(self, situation: Situation, contact: np.ndarray) -> AffineModel:
        x = (rows(situation) @ SELECT).astype(np.float32)
        bias, by_force = np.zeros((len(x), 3)), np.zeros((len(x), 3, 4))
        pushing = slice(None) if contact.all() else contact
        bias[pushing] = forward(self.weights.h1, x[pushing])
        by_force[pushing] = forward(self.weights.g1, x[pushing]).reshape(-1, 3, 4) * LIKE_CONTROL
        by_force[pushing] += self.body.force_rows(situation.foot[pushing])
        if not contact.all():
            bias[~contact] = forward(self.weights.h2, x[~contact])
        bias[:, 1] -= GRAVITY
        return AffineModel(bias, by_force)


def exported(weights: Weights) -> ExportedModel:
    """The same model in the form in which trained models are exported, which can be compiled."""
    at_rest, by_unit = (A1_BODY.force_rows(foot).reshape(-1, 12) for foot in (np.zeros(4), np.eye(4)))
    constant = np.concatenate([[0.0, -GRAVITY, 0.0], at_rest[0]])
    feet = np.pad(by_unit - at_rest, [(0, 0), (3, 0)])
    bias = [as_perceptron(net, slice(0, 3), 1.0) for net in (weights.h1, weights.h2)]
    contact = Phase(constant, feet, (bias[0], as_perceptron(weights.g1, slice(3, 15), LIKE_CONTROL)))
    in_air = Phase(np.pad(constant[:3], (0, 12)), 0 * feet, (bias[1],))
    purpose = Purpose(GRIDS["k10"], ContactSchedule(), "", "")
    return ExportedModel("random", purpose, contact, in_air)


def as_perceptron(net: Layers, outputs: slice, scale: float) -> Perceptron:
    """A network on all known inputs whose outputs are some of the fifteen, scaled."""
    hidden = [(weight.T, bias) for weight, bias in net[:-1]]
    hidden[0] = ((SELECT @ hidden[0][0]).astype(np.float32), hidden[0][1])
    last, last_bias = np.zeros((len(net[-1][0][0]), 15), np.float32), np.zeros(15, np.float32)
    last[:, outputs], last_bias[outputs] = net[-1][0].T * scale, net[-1][1] * scale
    return Perceptron(tuple((np.ascontiguousarray(w), b) for w, b in [*hidden, (last, last_bias)]))


class Plain:
    """The plain version of one jump: torch, matrices multiplied out, OSQP."""

    def __init__(self, reference: Reference, robot: Robot, weights: Weights, config: MpcConfig) -> None:
        self.reference, self.config, self.legs = reference, config, LegKinematics(robot)
        self.h1, self.h2, self.g1 = (self._torch(net) for net in (weights.h1, weights.h2, weights.g1))
        self.body = A1_BODY
        self.frame: StartFrame | None = None
        self.solvers: dict[int, osqp.OSQP] = {}
        self.force = np.zeros((0, 4))

    @staticmethod
    def _torch(net: Layers) -> torch.nn.Module:
        parts: list[torch.nn.Module] = []
        for weight, bias in net:
            linear = torch.nn.Linear(weight.shape[1], weight.shape[0])
            linear.weight.data, linear.bias.data = torch.from_numpy(weight.copy()), torch.from_numpy(bias.copy())
            parts += [linear, torch.nn.Tanh()]
        return torch.nn.Sequential(*parts[:-1]).eval()

    def command(self, estimate: StateEstimate) -> np.ndarray:
        """Joint torques of an update."""
        self.frame = self.frame or StartFrame.of(estimate)
        state, foot = self.frame.state(estimate), self.frame.foot(estimate, self.legs)
        steps = horizon(self.config.grid, self.reference.schedule, estimate.time_s)
        rows = self.reference.rows(steps.time_s)
        target = self.reference.state[rows[1:]]
        feet = np.concatenate([foot[None], self.reference.foot[rows[1:-1]]])
        states = np.concatenate([state[None], self.reference.state[rows[1:-1]]])
        bias, by_force = self._networks(states, feet, self.reference.state[rows[0]], steps.contact)
        free, gain = self._multiplied_out(state, bias, by_force, steps)
        self.force = self._solve(free, gain, target, self.reference.mean_force(steps.time_s), steps)
        pair_force = self.frame.in_world(self.force[0])
        return self.legs.torque(estimate.base_quaternion, estimate.joint_pos, pair_force)

    def _networks(
        self, states: np.ndarray, feet: np.ndarray, start: np.ndarray, contact: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        starts = np.concatenate([states[:1], np.tile(start, (len(states) - 1, 1))])
        situation = Situation(states, feet, np.zeros(len(states)), starts)
        x = torch.from_numpy(np.stack(columns(INPUTS, situation), axis=-1).astype(np.float32))
        with torch.no_grad():
            h1, h2, g1 = (net(x).numpy() for net in (self.h1, self.h2, self.g1))
        bias = np.where(contact[:, None], h1, h2).astype(float)
        bias[:, 1] -= GRAVITY
        by_force = self.body.force_rows(feet) + g1.reshape(-1, 3, 4) * LIKE_CONTROL
        return bias, by_force * contact[:, None, None]

    @staticmethod
    def _multiplied_out(
        state: np.ndarray, bias: np.ndarray, by_force: np.ndarray, steps: Horizon
    ) -> tuple[np.ndarray, np.ndarray]:
        """Free states (n, 6) and gain (n, 6, 4 n) of all forces, step by step."""
        n = len(steps)
        free, gain = np.zeros((n, 6)), np.zeros((n, 6, 4 * n))
        x, g = state, np.zeros((6, 4 * n))
        for k, dt in enumerate(steps.step_s):
            a = np.eye(6)
            a[:3, 3:] = dt * np.eye(3)
            x, g = a @ x, a @ g
            x[3:] += dt * bias[k]
            g[3:, 4 * k : 4 * k + 4] += dt * by_force[k]
            free[k], gain[k] = x, g
        return free, gain

    def _solve(
        self, free: np.ndarray, gain: np.ndarray, target: np.ndarray, force: np.ndarray, steps: Horizon
    ) -> np.ndarray:
        n, config = len(steps), self.config
        q = np.tile(config.weights.diagonal, n)
        flat = gain.reshape(6 * n, 4 * n)
        hessian = 2 * (flat.T @ (q[:, None] * flat) + config.force_weight * np.eye(4 * n))
        gradient = 2 * flat.T @ (q * (free - target).ravel()) - 2 * config.force_weight * force.ravel()
        pushing = per_axis(steps.share > 0)
        upper = np.concatenate([(config.limits.largest_n * pushing).ravel(), np.zeros(4 * n)])
        lower = np.concatenate([(-config.limits.largest_n * pushing).ravel(), np.full(4 * n, -1e30)])
        index = np.arange(4 * n).reshape(n, 4)
        lower[index[:, FORCE_Z]] = 0.0
        triangle = np.triu_indices(4 * n)
        if n not in self.solvers:
            cone = np.zeros((4 * n, 4 * n))
            x, z = index[:, FORCE_X].ravel(), index[:, FORCE_Z].ravel()
            up, down = np.arange(0, 4 * n, 2), np.arange(1, 4 * n, 2)
            cone[up, x], cone[down, x] = 1.0, -1.0
            cone[up, z] = cone[down, z] = -config.limits.friction
            dense = sparse.csc_matrix((np.ones(len(triangle[0])), triangle), shape=(4 * n, 4 * n))
            dense.data = hessian.T[np.tril_indices(4 * n)]
            self.solvers[n] = osqp.OSQP()
            rows = sparse.csc_matrix(np.concatenate([np.eye(4 * n), cone]))
            self.solvers[n].setup(dense, gradient, rows, lower, upper, verbose=False, adaptive_rho_interval=25)
        else:  # the upper triangle column by column is the lower one row by row
            self.solvers[n].update(Px=hessian.T[np.tril_indices(4 * n)], q=gradient, l=lower, u=upper)
        return self.solvers[n].solve(raise_error=False).x.reshape(n, 4)


def estimates(jump: Log, robot: Robot) -> list[StateEstimate]:
    """What the controller would have been told at each update of a logged jump."""
    position, quaternion, velocity = (jump.stack(c) for c in (BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY))
    joint_pos, joint_vel = (jump.per_joint(c, robot.joints) for c in ("joint_pos", "joint_vel"))
    turning = np.stack([0 * jump.time, jump["base_angvel_y"], 0 * jump.time], axis=1)
    touching = np.ones(len(robot.feet), dtype=bool)
    rows = [int(np.argmin(np.abs(jump.time - t))) for t in np.arange(0, schedule_of(jump).take_off_s - 1e-6, 0.025)]
    measured = (position, quaternion, velocity, turning, joint_pos, joint_vel)
    return [StateEstimate(0.025 * i, *(part[row] for part in measured), touching) for i, row in enumerate(rows)]


def nearest(jump: Log, targets: Iterable[tuple[float, float]]) -> tuple[float, float]:
    """The target (x, z), m, that is nearest to that of a jump."""
    own = target_of(jump)
    return min(targets, key=lambda target: math.dist(target, (own.x_m, own.z_m)))


def recorded_jumps(robot: Robot, needed: int = 4) -> tuple[str, list[tuple[Reference, list[StateEstimate]]]]:
    """Jumps with the reference nearest to their target: published ones, where there are some, else simulated ones."""
    references = {
        (target_of(j).x_m, target_of(j).z_m): Reference.of(j, robot)
        for j in jump_log.read_logs(Path("data/references/own"))
    }
    for folder in ("published", "simulated"):
        path = Path("data/jumps") / folder
        jumps = jump_log.read_logs(path) if path.is_dir() else []
        if references and len(jumps) >= needed:
            return folder, [(references[nearest(jump, references)], estimates(jump, robot)) for jump in jumps]
    raise SystemExit(f"no {needed} jumps, or no reference: run `dvc repro collect optimize import_logs` first")


@dataclass
class Timings:
    """Times and errors of one version of the controller."""

    microseconds: list[float] = field(default_factory=list)
    """Wall-clock time of each tick."""
    cpu_microseconds: list[float] = field(default_factory=list)
    """CPU time of this thread in each tick, without other processes."""
    qp_microseconds: list[float] = field(default_factory=list)
    error_n: float = 0.0

    def tick(self, work: Callable[[], object]) -> None:
        """Do it and note how long it took."""
        wall, cpu = time.perf_counter(), time.thread_time()
        work()
        self.cpu_microseconds.append(1e6 * (time.thread_time() - cpu))
        self.microseconds.append(1e6 * (time.perf_counter() - wall))

    def row(self) -> dict[str, float]:
        found = {}
        for name, ticks in (("", self.microseconds), ("cpu_", self.cpu_microseconds)):
            of_ticks = {"median": np.median(ticks), "p99": np.percentile(ticks, 99)}
            of_ticks |= {"p99_9": np.percentile(ticks, 99.9), "worst": max(ticks)}
            found |= {name + k: v for k, v in of_ticks.items()}
        return {**{k: round(float(v), 1) for k, v in found.items()}, "force_error_n": float(f"{self.error_n:.2g}")}


def measure(
    grid: TimeGrid, jumps: list[tuple[Reference, list[StateEstimate]]], robot: Robot, rounds: int
) -> dict[str, Timings]:
    """All versions at all recorded states, taking turns jump by jump."""
    weights, small = Weights.of(PAPER), Weights.of(SMALL)
    kinds: dict[str, tuple[PredictionModel, MpcConfig]] = {
        "daqp": (Networks(weights), MpcConfig(grid)),
        "osqp": (Networks(weights), MpcConfig(grid, qp=QpConfig("osqp"))),
        "daqp_small_networks": (Networks(small), MpcConfig(grid)),
    }
    if compiler.AVAILABLE:
        kinds["compiled"] = (exported(weights), MpcConfig(grid, compiled=True))
        kinds["compiled_small_networks"] = (exported(small), MpcConfig(grid, compiled=True))
    plain_kinds = {"torch_osqp": weights, "torch_osqp_small_networks": small}
    timed = {name: Timings() for name in (*plain_kinds, *kinds)}
    for reference, told in jumps * rounds:
        warm, ours = (
            {name: JumpMpc(reference, robot, PhaseGains(), model, config) for name, (model, config) in kinds.items()}
            for _ in range(2)
        )
        plain = {name: Plain(reference, robot, w, MpcConfig(grid)) for name, w in plain_kinds.items()}
        gc.collect()
        gc.freeze()  # as a robot would: nothing of before is looked at again
        gc.disable()
        plans = {}
        for name, mpc in ours.items():
            follow_jump(warm[name], told, Timings())
            plans[name] = follow_jump(mpc, told, timed[name])
        forces = {name: [] for name in plain}  # type: dict[str, list[np.ndarray]]
        for name, version in plain.items():
            for estimate in told:
                version.command(estimate)
            for estimate in told:
                timed[name].tick(lambda version=version, estimate=estimate: version.command(estimate))
                forces[name].append(version.force)
        gc.enable()
        judge(plans, forces, timed)
    return timed


def follow_jump(mpc: JumpMpc, told: list[StateEstimate], timed: Timings) -> list[ForcePlan]:
    """The plans of one jump, timed; a fallback would be no measurement."""
    plans = []
    for estimate in told:
        timed.tick(lambda estimate=estimate: mpc.command(estimate))
        plan = mpc.plan_now
        if plan is None or plan.fallback is not None:
            raise SystemExit(f"at {estimate.time_s:g} s: {plan.fallback if plan else 'no plan'}")
        if plan.solution is not None:
            timed.qp_microseconds.append(1e6 * plan.solution.seconds)
        plans.append(plan)
    return plans


def judge(plans: dict[str, list[ForcePlan]], forces: dict[str, list[np.ndarray]], timed: dict[str, Timings]) -> None:
    """Largest deviation of each version's forces from the exact ones of the same networks."""
    for name in ("daqp", "daqp_small_networks"):
        same_networks = [name.replace("daqp", kind) for kind in ("daqp", "osqp", "compiled", "torch_osqp")]
        for i, exact in enumerate(plans[name]):
            if exact.solution is None:
                raise SystemExit(f"{name}: a plan without its problem")
            x = by_least_distance(exact.solution.problem)
            pushing = per_axis(exact.horizon.share > 0)
            for kind in same_networks:
                force = plans[kind][i].force if kind in plans else forces[kind][i] if kind in forces else None
                if force is not None:
                    error = float(np.abs(force[pushing] - x).max())
                    timed[kind].error_n = max(timed[kind].error_n, error)


def main() -> None:
    """Run the measurement and write its figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, required=True)
    parser.add_argument("--tiny", action="store_true", help="smallest counts, to see that it runs")
    chosen = parser.parse_args()
    file = chosen.json
    torch.set_num_threads(1)
    robot = Robot.load()
    source, jumps = recorded_jumps(robot, 1 if chosen.tiny else 4)
    rounds = ROUNDS
    if chosen.tiny:
        jumps, rounds = [(reference, states[:TINY_STATES]) for reference, states in jumps[:1]], 1
    results = {name: measure(grid, jumps, robot, rounds) for name, grid in GRIDS.items()}
    with busy_cores():
        loaded = measure(GRIDS["k10"], jumps[:4], robot, 1)
    compiled = "compiled" if compiler.AVAILABLE else "daqp"
    ours = {k: results[k][compiled].row() for k in GRIDS}
    result = {
        **{f"tick_us_{part}": {k: ours[k][part] for k in GRIDS} for part in ("median", "p99", "p99_9", "worst")},
        "qp_us_median": {
            b: {k: round(float(np.median(results[k][b].qp_microseconds)), 1) for k in GRIDS} for b in ("daqp", "osqp")
        },
        "force_error_n": {name: {k: results[k][name].row()["force_error_n"] for k in GRIDS} for name in results["k10"]},
        "ratio_to_torch_osqp": {k: ratio(results[k], compiled, "torch_osqp", "median") for k in GRIDS},
        "ratio_to_torch_osqp_cpu": {k: ratio(results[k], compiled, "torch_osqp", "cpu_median") for k in GRIDS},
        "bars": bars(results["k10"], compiled),
        "versions": {k: {name: timed.row() for name, timed in results[k].items()} for k in GRIDS},
        "under_load": {"k10": {name: timed.row() for name, timed in loaded.items()}},
        "updates": {k: len(results[k]["daqp"].microseconds) for k in GRIDS},
        "states": f"{len(jumps)} {source} jumps",
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, one thread, torch {torch.__version__}",
    }
    write_json(file, result)
    for k, versions in {**results, "k10, one busy process a core": loaded}.items():
        print(f"{k}, µs a tick (median, p99, p99.9, worst; the same of this thread) and largest force error, N:")
        for name, timed in versions.items():
            print(f"  {name:27}" + "".join(f" {value:9.3g}" for value in timed.row().values()))
    for bar, figures in result["bars"].items():
        print(f"  {bar:33} " + ", ".join(f"{name} {value}" for name, value in figures.items()))
    print(f"{result['states']}, {result['machine']}")


def ratio(versions: dict[str, Timings], ours: str, plain: str, part: str, plain_part: str | None = None) -> float:
    """A figure of one version as a share of one of another."""
    return round(versions[ours].row()[part] / versions[plain].row()[plain_part or part], 4)


def bars(versions: dict[str, Timings], compiled: str) -> dict[str, dict[str, float]]:
    """What a tick may take, as shares of the median of torch + OSQP in this run, and what it took."""
    shares = {}
    for networks, limits in (("paper", {"median": 160, "p99": 300}), ("small", {"median": 100, "p99": 150})):
        ours = compiled + ("_small_networks" if networks == "small" else "")
        for part, limit_us in limits.items():
            shares[f"{networks}_networks_{part}"] = {
                "bar": round(limit_us / PLAIN_WHERE_BARS_WERE_SET_US, 4),
                "share": ratio(versions, ours, "torch_osqp", part, "median"),
                "share_cpu": ratio(versions, ours, "torch_osqp", f"cpu_{part}", "cpu_median"),
            }
    return shares


@contextlib.contextmanager
def busy_cores() -> Iterator[None]:
    """A process on every core that computes and reads memory without end."""
    work = "import numpy\na = numpy.ones(1 << 21)\nwhile True: a += numpy.tanh(a)"
    running = [subprocess.Popen([sys.executable, "-c", work]) for _ in range(os.cpu_count() or 1)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


if __name__ == "__main__":
    main()
