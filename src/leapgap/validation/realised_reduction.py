"""The realised closure: the share of the gap that an answer closes on jumps that were kept with the truth."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from leapgap.diagnosis.checks.clocks import JointClock
from leapgap.diagnosis.gap import candidate_squares, headline_gap, noise_floor
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.effects.base import Effect
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer

NOISE_DRAWS = 3
CLOCK = "joint_clock"


def realised_closure(
    proof: Sequence[Log], robot: Robot, correction: Sequence[Effect], report: Mapping[str, Any], seed: int
) -> float:
    """(nominal − corrected) / (nominal − noise floor) of the headline gap on the proof jumps.

    The value of an effect that differs from log to log comes from the clock of the joints on each proof jump, as in the
    report.
    """
    judged = JudgedLogs.of(proof, robot)
    replayer = Replayer(robot, terrain_slots=max(1, *(len(jump.info.terrain) for jump in proof)), threads=1)
    corrected = [
        tuple(effect_on_log(effect, jump, judged, robot, report) for effect in correction) for jump in judged.logs
    ]
    nominal, after = candidate_squares(judged, replayer, [[()] * len(proof), corrected])
    floor = noise_floor(judged, replayer, NOISE_DRAWS, np.random.default_rng(seed))
    before, left, least = (headline_gap(s, judged) for s in (nominal, after, floor))
    return float((before - left) / max(before - least, 1e-12))


def effect_on_log(effect: Effect, jump: Log, judged: JudgedLogs, robot: Robot, report: Mapping[str, Any]) -> Effect:
    """The effect on a jump that was not fitted; where it differs by log, it is scaled by the clock of that jump.

    The effect is returned unchanged where the report holds no values by log.
    """
    if not effect.differs_per_log:
        return effect
    cause = next((c for c in report["causes"] if c["effect"] == effect.called(robot)), None)
    clocks = next((c["per_log"] for c in report["checks"] if c["name"] == CLOCK and c.get("per_log")), None)
    check = JointClock().run([jump], robot, threshold=0.0)
    if not (cause and cause.get("per_log") and clocks and check):
        return effect
    parameter = effect.parameters(robot, effect.location)[0]
    name = parameter.name
    shares = [
        (cause["per_log"][log][name] - 1) / (clocks[log] - 1) for log in cause["per_log"] if clocks.get(log, 1) != 1
    ]
    (clock,) = check.per_log.values()
    value = float(np.clip(1 + np.median(shares) * (clock - 1), parameter.lower, parameter.upper))
    changed: dict[str, Any] = {name: value}
    return replace(effect, **changed)
