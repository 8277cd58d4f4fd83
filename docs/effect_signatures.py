"""Signatures of effects: the trace of each effect by phase and channel in replays of short pieces.

``python -m docs.effect_signatures data/references/own/h00_d50.parquet docs/research/effects.md`` renews the tables
in the page.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from leapgap import effects
from leapgap.diagnosis.localisation import phase_names, phase_of_rows
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.logs import log as jump_log
from leapgap.logs.log import Log
from leapgap.robot.kinematics import momenta
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.robot.rotations import pitch_of
from leapgap.runtime.atomic_io import write_text
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout

CHANNELS = {
    "com_acceleration_x": ("m/s²", 1.0),
    "com_acceleration_z": ("m/s²", 1.0),
    "angular_momentum_rate_y": ("N·m", 1.0),
    "base_pitch": ("rad", 0.01),
    "base_linvel_x": ("m/s", 0.05),
    "base_linvel_z": ("m/s", 0.05),
    "base_angvel_y": ("rad/s", 0.1),
    "joint_pos": ("rad", 0.01),
    "joint_vel": ("rad/s", 0.3),
}
"""Channels of a signature: unit and scale. The first three are of the whole robot: means over the
second half of a piece, of its centre of mass by the nominal model and the true pose; the others are as reported, root
mean square over joints and over the second half."""

SILENT = 0.1
"""Traces below this share of a channel's scale are left out of the table."""


@dataclass(frozen=True)
class Signature:
    """Root-mean-square trace of each effect, ``values[effect, phase, channel]`` in units of the channels."""

    names: tuple[str, ...]
    """Effects; ``effect: parameter`` where one has several."""
    phases: tuple[str, ...]
    values: np.ndarray

    def of(self, name: str, phase: str) -> dict[str, float]:
        """Trace of an effect in one phase, by channel."""
        return dict(zip(CHANNELS, self.values[self.names.index(name), self.phases.index(phase)].tolist(), strict=True))

    def markdown(self) -> str:
        """Markdown tables, one a phase: traces in units of the channels, a dot for a negligible one."""
        scale = np.array([one for _, one in CHANNELS.values()])
        lines = []
        for p, phase in enumerate(self.phases):
            lines += ["", f"### {phase.replace('_', ' ')}", ""]
            heads = (f"{channel} ({unit})" for channel, (unit, _) in CHANNELS.items())
            lines += [f"| effect | {' | '.join(heads)} |", f"|---|{'---:|' * len(CHANNELS)}"]
            for e, name in enumerate(self.names):
                cells = (
                    f"{value:.2g}" if value >= SILENT * one else "·"
                    for value, one in zip(self.values[e, p], scale, strict=True)
                )
                lines.append(f"| {name} | {' | '.join(cells)} |")
        return "\n".join(lines)


def moderate_effects(robot: Robot) -> dict[str, Effect]:
    """Every known effect at its moderate size on a robot, one parameter at a time."""
    found = {}
    for name, kind in effects.known().items():
        parameters = kind.parameters(robot)
        for parameter in parameters:
            label = name if len(parameters) == 1 else f"{name}: {parameter.name}"
            (found[label],) = effects.from_config([{"name": name, parameter.name: parameter.moderate}])
    return found


def signature(
    reference: Log, robot: Robot, effects_by_label: Mapping[str, Effect], horizon_s: float = 0.05
) -> Signature:
    """Traces of effects in the nominal robot's own motion: replay with the effect − replay without, from equal starts.

    The log is cut into pieces of one horizon. Each piece starts from the nominal motion, which stands for the logged
    one, so that a trace counts in the phase in which it arises. The second half of a piece counts, after its start
    has settled.
    """
    replayer = Replayer(robot, terrain_slots=max(1, len(reference.info.terrain)))
    (motion,) = replayer.motions([Rollout(reference)])
    pieces = pieces_of_phases(replayer.as_log(motion, reference), horizon_s)
    phases = tuple(phase for phase in phase_names([reference]) if any(p == phase for p, _ in pieces))
    candidates: Sequence[tuple[Effect, ...]] = [(), *((one,) for one in effects_by_label.values())]
    trials = [Rollout(piece, of) for of in candidates for _, piece in pieces]
    true = replayer.true_motions(trials)
    traces = [
        trace_of(replayer.measure(trial, whole), whole, trial, robot) for trial, whole in zip(trials, true, strict=True)
    ]
    values = np.zeros((len(effects_by_label), len(phases), len(CHANNELS)))
    for e in range(len(effects_by_label)):
        for p, phase in enumerate(phases):
            chosen = [i for i, (own, _) in enumerate(pieces) if own == phase]
            values[e, p] = np.sqrt(
                np.mean([distance(traces[(e + 1) * len(pieces) + i], traces[i]) ** 2 for i in chosen], axis=0)
            )
    return Signature(tuple(effects_by_label), phases, values)


def pieces_of_phases(log: Log, horizon_s: float) -> list[tuple[str, Log]]:
    """Pieces of one horizon that lie within one phase each."""
    length = max(4, round(horizon_s / log.info.sample_period_s)) + 1
    names = phase_names([log])
    phases = phase_of_rows(log, names)
    found = []
    for start in range(0, len(log) - length + 1, length - 1):
        own = phases[start : start + length]
        if own[0] == own[-2]:
            columns = {name: values[start : start + length] for name, values in log.columns.items()}
            found.append((names[own[0]], replace(log, columns=columns)))
    return found


@dataclass(frozen=True)
class Trace:
    """Second half of a piece in the channels of a signature."""

    of_robot: np.ndarray
    """(3,): acceleration of the centre of mass x, z, and rate of angular momentum about it, y."""
    base: np.ndarray
    """(rows, 4): pitch, vx, vz, pitch rate."""
    joint_pos: np.ndarray
    joint_vel: np.ndarray


def trace_of(measured: Motion, true: Motion, trial: Rollout, robot: Robot) -> Trace:
    """Trace of one piece, with time by the log's clock as in a diagnosis."""
    half = slice(len(true.qpos) // 2, None)
    momentum = momentum_of(true, robot)[half]
    seconds = (len(momentum) - 1) * trial.log.info.sample_period_s
    return Trace(
        (momentum[-1] - momentum[0]) / seconds / np.array([robot.total_mass, robot.total_mass, 1.0]),
        np.column_stack([pitch_of(measured.base_quaternion), measured.qvel[:, [0, 2, 4]]])[half],
        measured.qpos[half][:, robot.joint_qpos],
        measured.qvel[half][:, robot.joint_dofs],
    )


def momentum_of(motion: Motion, robot: Robot) -> np.ndarray:
    """Momentum x, z (kg·m/s) and angular momentum y about the centre of mass (kg·m²/s), (rows, 3)."""
    linear, angular = momenta(robot, motion)
    return np.stack([linear[:, 0], linear[:, 2], angular[:, 1]], axis=1)


def distance(one: Trace, other: Trace) -> np.ndarray:
    """Difference in each channel, (channels,)."""

    def rms(a: np.ndarray, b: np.ndarray, axis: int | None = None) -> np.ndarray:
        return np.asarray(np.sqrt(np.mean((a - b) ** 2, axis=axis)))

    return np.concatenate(
        [
            np.abs(one.of_robot - other.of_robot),
            rms(one.base, other.base, axis=0),
            [rms(one.joint_pos, other.joint_pos), rms(one.joint_vel, other.joint_vel)],
        ]
    )


MARK = "<!-- The rest is written by docs.effect_signatures. -->"


def main(arguments: Sequence[str]) -> None:
    """Write the signature in a reference's replay below the mark of a page."""
    if len(arguments) != 2:
        raise InputError("arguments", " ".join(arguments) or "none", "<reference.parquet> <page.md>", "give both")
    reference, page = jump_log.read_log(Path(arguments[0])), Path(arguments[1])
    text = page.read_text(encoding="utf-8")
    if MARK not in text:
        raise InputError(page, "no mark", MARK, "put it where the tables are to begin")
    robot = Robot.load()
    found = signature(reference, robot, moderate_effects(robot))
    write_text(page, text[: text.index(MARK)] + MARK + "\n" + found.markdown() + "\n")


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except InputError as error:
        sys.exit(f"signature: {error}")
