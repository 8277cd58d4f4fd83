"""The realised closure: what an answer closes on jumps that nobody but the truth has seen."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from leapgap.diagnosis.checks.joint_clock import JointClock
from leapgap.diagnosis.gap import Judged, noise_floor, pooled, squares
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

    An effect that differs from log to log gets its value there from the joints' clock, as the report got it.
    """
    judged = Judged.of(proof, robot)
    replayer = Replayer(robot, terrain_slots=max(1, *(len(jump.info.terrain) for jump in proof)), threads=1)
    corrected = [tuple(on_log(effect, jump, judged, robot, report) for effect in correction) for jump in judged.jumps]
    nominal, after = squares(judged, replayer, [[()] * len(proof), corrected])
    floor = noise_floor(judged, replayer, NOISE_DRAWS, np.random.default_rng(seed))
    before, left, least = (pooled(s, judged) for s in (nominal, after, floor))
    return float((before - left) / max(before - least, 1e-12))


def on_log(effect: Effect, jump: Log, judged: Judged, robot: Robot, report: Mapping[str, Any]) -> Effect:
    """The effect on a jump that was not fitted on: scaled by that jump's own clock where it differs by log."""
    if not effect.differs_per_log:
        return effect
    cause = next((c for c in report["causes"] if c["effect"] == effect.name), None)
    told = next((c["per_log"] for c in report["checks"] if c["name"] == CLOCK and c.get("per_log")), None)
    found = JointClock().run([jump], robot, threshold=0.0)
    if not (cause and cause.get("per_log") and told and found):
        return effect
    parameter = effect.parameters(robot, effect.location)[0]
    name = parameter.name
    shares = [(cause["per_log"][log][name] - 1) / (told[log] - 1) for log in cause["per_log"] if told.get(log, 1) != 1]
    (clock,) = found.per_log.values()
    value = float(np.clip(1 + np.median(shares) * (clock - 1), parameter.lower, parameter.upper))
    changed: dict[str, Any] = {name: value}
    return replace(effect, **changed)
