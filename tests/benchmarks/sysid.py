"""Side by side with ``mujoco.sysid``: every parameter fitted at once, on the same logs, with the same weights.

Both see four jumps and are judged on further ones of the same robot. The peer gets what its authors advise: scaled
parameters, starts off the bounds, Gauss–Newton in bounds, its own 95 % intervals; its residuals are those of the
diagnosis (replays of 0.1 s from the log, whitened by sensor noise), so that only the way to an answer differs. A
parameter whose interval leaves out nominal is what it says. Needs ``pip install -e ".[peers]"``. Run as
``python -m tests.benchmarks.sysid --json <file>``; takes about half an hour.
"""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mujoco import sysid
from omegaconf import OmegaConf

from leapgap import effects
from leapgap.atomic_io import write_json
from leapgap.diagnosis.diagnose import Settings, diagnose
from leapgap.diagnosis.gap import candidate_squares, closure, headline_gap, resamples
from leapgap.diagnosis.hypotheses import Hypothesis, list_hypotheses
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.noise_floor import noise_floor
from leapgap.diagnosis.sensitivities import concatenate_logs, on_logs
from leapgap.diagnosis.short_rollouts import ShortRollouts
from leapgap.effects.base import Effect
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from stages.common import read_config
from tests.benchmarks.diagnose import tiny
from tests.benchmarks.diagnosis_injected import DISTANCES, Case, cases, jumps_of

CHOSEN = (
    "moderate joint_damping", "moderate torque_gain", "moderate payload", "moderate command_delay",
    "moderate foot_friction", "moderate encoder_bias", "large leg_mass", "placed torque_gain at RR_calf",
    "pair joint_damping", "pair torque_gain", "none",
)  # fmt: skip
STEP, MOST_ITERATIONS = 0.02, 30
"""Finite differences, in moderate departures; iterations of the peer."""


def peer(
    logs: Sequence[Log], robot: Robot, settings: Settings, iterations: int
) -> tuple[dict[str, list[float]], tuple[Effect, ...]]:
    """Every parameter at once: those whose interval leaves out nominal, as departures, and all effects."""
    everything = [h for h in list_hypotheses(list(effects.by_default()), robot, None) if h.location == "all"]
    replayer = Replayer(robot)
    judged = JudgedLogs.of(logs, robot)
    most = min(settings.most_pieces, settings.pieces_per_log * len(logs))
    bare = ShortRollouts.of(judged.states, replayer, settings.horizon_s, settings.every_s, most)
    evidence = bare.whiten_for(bare.on_every_log(()))
    names = [(h, k, p) for h in everything for k, p in enumerate(h.parameters)]
    scale = np.array([h.moderate[k] for h, k, _ in names])
    nominal = np.array([p.nominal for _, _, p in names])
    parameters = sysid.ParameterDict()
    for (h, _, p), size in zip(names, scale, strict=True):
        low, high = sorted(((p.lower - p.nominal) / size, (p.upper - p.nominal) / size))
        parameters.add(sysid.Parameter(f"{h.name}.{p.name}", 0.0, low, high))
    parameters.move_off_bounds()

    def acting(x: np.ndarray) -> list[tuple[Hypothesis, np.ndarray]]:
        values = nominal + scale * x
        return [(h, np.array([v for v, (of, _, _) in zip(values, names, strict=True) if of is h])) for h in everything]

    def residual(x: np.ndarray, _: sysid.ParameterDict) -> tuple[list[np.ndarray], None, None]:
        columns = x.reshape(len(names), -1).T
        found = evidence.residuals([on_logs(evidence, *acting(one)) for one in columns])
        errors = np.stack([concatenate_logs(of).ravel() for of in found], axis=1)
        return [errors if x.ndim > 1 else errors[:, 0]], None, None

    fitted, result = sysid.optimize(parameters, residual, verbose=False, eps=STEP, max_iters=iterations)
    x = fitted.as_vector()
    _, half = sysid.calculate_intervals(residual(x, fitted)[0], result.jac)
    conclusion: dict[str, list[float]] = {}
    for (h, _, _), value, width in zip(names, x, half, strict=True):
        if abs(value) > width:
            conclusion.setdefault(h.name, []).append(float(value))
    return conclusion, tuple(h.on(logs[0].name, numbers) for h, numbers in acting(x))


def heldout(correction: Sequence[Effect], proof: Sequence[Log], robot: Robot, settings: Settings) -> dict[str, float]:
    """Headline gap of a correction on jumps that nobody saw, and how much of the nominal one it closes."""
    judged, replayer = JudgedLogs.of(proof, robot), Replayer(robot)
    nominal, after = candidate_squares(judged, replayer, [[()] * len(proof), [tuple(correction)] * len(proof)])
    floor = noise_floor(judged, replayer, settings.noise_draws, np.random.default_rng(0))
    closed = closure(nominal, after, floor, judged, resamples(len(proof), 1, np.random.default_rng(0))).value
    return {"gap_nominal": headline_gap(nominal, judged), "gap": headline_gap(after, judged), "closure": closed}


def compare(case: Case, robot: Robot, settings: Settings, iterations: int) -> dict[str, Any]:
    """One robot, both ways."""
    logs = jumps_of(case, robot)
    seen, proof = logs[: len(DISTANCES)], logs[len(DISTANCES) :]
    true = {e.name for e in case.effects}
    began = time.perf_counter()
    found = diagnose(seen, robot, settings)
    ours_s = time.perf_counter() - began
    ours = {name for names in found.report.answer for name in names[:1]}
    began = time.perf_counter()
    conclusion, everything = peer(seen, robot, settings, iterations)
    peer_s = time.perf_counter() - began
    return {
        "case": case.label,
        "true": sorted(true),
        "leapgap": {
            "says": sorted(ours),
            "wrong": len(ours - true),
            "missed": len(true - ours),
            "seconds": ours_s,
            **heldout(found.correction, proof, robot, settings),
        },
        "sysid": {
            "says": sorted(conclusion),
            "wrong": len(set(conclusion) - true),
            "missed": len(true - set(conclusion)),
            "seconds": peer_s,
            **heldout(everything, proof, robot, settings),
        },
    }


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Means over the cases."""
    keys = ("wrong", "missed", "seconds", "gap", "closure")
    with_gap = [row for row in rows if row["true"]]
    return {
        who: {key: float(np.mean([row[who][key] for row in (with_gap if key == "closure" else rows)])) for key in keys}
        for who in ("leapgap", "sysid")
    }


def main() -> None:
    """Run the comparison and write its figures as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--json", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--tiny", action="store_true", help="smallest counts, to see that it runs")
    arguments = parser.parse_args()
    robot = Robot.load()
    settings = read_config(Settings, OmegaConf.load("params.yaml").diagnose.settings, "diagnose.settings")
    settings, iterations = (tiny(settings), 1) if arguments.tiny else (settings, MOST_ITERATIONS)
    chosen = [next(case for case in cases() if case.label.startswith(label)) for label in CHOSEN]
    rows = []
    for case in chosen[:1] if arguments.tiny else chosen:
        if not case.label.startswith(arguments.only):
            continue
        rows.append(compare(case, robot, settings, iterations))
        for who in ("leapgap", "sysid"):
            one = rows[-1][who]
            told = f"{', '.join(one['says']) or 'nothing'}: gap {one['gap_nominal']:.3f} to {one['gap']:.3f}"
            print(f"{case.label} | {who} | {told} | {one['seconds']:.0f} s", flush=True)
    found = {"cases": len(rows), **summary(rows), "rows": rows}
    print(OmegaConf.to_yaml(OmegaConf.create(summary(rows))))
    if arguments.json:
        write_json(arguments.json, found)


if __name__ == "__main__":
    main()
