"""How alike effects are in some logs: correlation of what they change in short replays of all channels.

Two effects whose changes are alike are hard to tell apart by these logs, whatever fit is made. Changes are in units of
the channels' noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leapgap import effects
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.report import Cause
from leapgap.diagnosis.short_rollouts import ShortRollouts
from leapgap.effects import effect_words
from leapgap.effects.base import Effect
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer

MOST_CAUSES = 6
MOST_PIECES = 12
"""Numbers of effects and of short replays of each that are compared; it bounds the time to a second or two."""
HORIZON_S, EVERY_S = 0.1, 0.01
"""Length of the replays and interval of comparison, s, where the settings of the diagnosis name none."""


@dataclass(frozen=True)
class Similarity:
    """Correlations of the changes by effects."""

    names: tuple[str, ...]
    """Effects with their places, such as ``viscous friction (elbow)``."""
    correlation: np.ndarray
    """Between −1 and 1, (effects, effects)."""


def similarity(
    causes: Sequence[Cause], logs: Sequence[Log], robot: Robot, horizon_s: float = HORIZON_S, every_s: float = EVERY_S
) -> Similarity | None:
    """Correlations between the first causes at their fitted values; None where fewer than two change anything."""
    acting = [(f"{effect_words(cause.effect)} ({cause.location})", effect_of(cause)) for cause in causes[:MOST_CAUSES]]
    known = [(name, effect) for name, effect in acting if effect is not None]
    if len(known) < 2:
        return None
    replayer = Replayer(robot, max(1, *(len(log.info.terrain) for log in logs)))
    pieces = ShortRollouts.of(JudgedLogs.of(logs, robot).states, replayer, horizon_s, every_s, MOST_PIECES)
    without = errors(pieces, ())
    changes = {name: errors(pieces, (effect,)) - without for name, effect in known}
    sizes = {name: float(np.linalg.norm(change)) for name, change in changes.items()}
    names = tuple(name for name, size in sizes.items() if size > 0 and np.isfinite(size))
    if len(names) < 2:
        return None
    unit = np.stack([changes[name] / sizes[name] for name in names])
    return Similarity(names, unit @ unit.T)


def effect_of(cause: Cause) -> Effect | None:
    """A cause as an effect with its fitted values; None for a class of somebody's own."""
    if cause.effect not in effects.known():
        return None
    return effects.effect(cause.effect, cause.location, **{name: one.value for name, one in cause.parameters.items()})


def errors(pieces: ShortRollouts, acting: tuple[Effect, ...]) -> np.ndarray:
    """Simulated − logged in all short replays in units of the channels' noise, one vector."""
    found = pieces.errors([(number, acting, one.starts) for number, one in enumerate(pieces.pieces)])
    scaled = [error / np.tile(one.noise, len(one.ages)) for error, one in zip(found, pieces.pieces, strict=True)]
    return np.nan_to_num(np.concatenate([of.ravel() for of in scaled]), nan=0.0, posinf=0.0, neginf=0.0)
