"""Logs that a referee judges: cut into the intervals of the engine, with all effects that it looks for."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leapgap.diagnosis.diagnose import chosen_kinds, kinds_by_evidence, tolerances_on
from leapgap.diagnosis.engine.points import Bench
from leapgap.diagnosis.gap import folds_of, scaled_errors
from leapgap.diagnosis.horizons import gap_of, horizons_of, unmoved_errors
from leapgap.diagnosis.hypotheses import list_hypotheses
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.restarts import replayer_at
from leapgap.diagnosis.settings import Settings
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer


@dataclass(frozen=True)
class AtHorizon:
    """Errors of replays that start anew from the log after a time, in units of the headline gap."""

    horizon_s: float | None  # None: whole logs
    nominal: float
    corrected: float
    frozen: float  # Of a robot that does not move from each start (baseline)


@dataclass(frozen=True)
class RefereedLogs:
    """Logs with the bench of the engine."""

    judged: JudgedLogs
    bench: Bench
    folds: np.ndarray  # Fold of each log

    @staticmethod
    def of(where: str, logs: Sequence[Log], robot: Robot, settings: Settings, threads: int | None) -> "RefereedLogs":
        """Cut the logs; ``where`` names the command in errors."""
        if len(logs) < 2:
            expected = "two or more: what acts is judged on logs it was not fitted on"
            raise InputError(where, f"{len(logs)} log", expected, "name more logs of the same robot")
        judged = JudgedLogs.of(logs, robot, settings.sizes)
        slots = max((len(log.info.terrain) for log in logs), default=0)
        replayer = Replayer(robot, max(1, slots), threads, sensors=judged.sensors.columns)
        hypotheses = list_hypotheses(kinds_by_evidence(chosen_kinds(settings), settings), robot, None)
        bench = Bench(hypotheses, tolerances_on(robot, settings), judged.states, replayer)
        return RefereedLogs(judged, bench, folds_of(len(logs), settings.folds))

    def errors_left(self, correction: tuple[Effect, ...]) -> tuple[dict[str, float], tuple[AtHorizon, ...]]:
        """Shares of the channels in what a correction leaves at the shortest horizon, the largest first, and errors.

        Errors are those at several horizons, the longest first.
        """
        judged, rows, left = self.judged, list[AtHorizon](), np.zeros(len(self.judged.channels))
        sets = [[one for _ in judged.logs] for one in ((), correction)]
        for horizon in horizons_of(judged):
            nominal, corrected = scaled_errors(judged, replayer_at(self.bench.replayer, horizon), sets)
            still = unmoved_errors(judged, horizon)
            rows.append(AtHorizon(horizon, gap_of(nominal), gap_of(corrected), gap_of(still)))
            left = np.sum([(error**2).sum(axis=0) for error in corrected], axis=0)
        shares = left / max(left.sum(), 1e-300)
        order = np.argsort(-shares, kind="stable")
        return {judged.channels[k].name: float(shares[k]) for k in order}, tuple(rows)
