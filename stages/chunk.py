"""Cut jump logs into the windows that models are trained and evaluated on.

Examples:

    python -m stages.chunk chunk.logs=data/jumps/simulated chunk.out=windows
    python -m stages.chunk chunk.logs=jumps chunk.flight_step_s=0.05 chunk.out=windows
    python -m stages.chunk chunk.logs=jumps chunk.clock=own chunk.out=windows
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from omegaconf import DictConfig

from leapgap.errors import InputError
from leapgap.jumping.learning import window_extraction, windows
from leapgap.jumping.learning.windows import TimeGrid
from leapgap.logs.log import Log
from leapgap.logs.reading import read_folder
from leapgap.logs.row_clock import RowClock
from leapgap.logs.row_clock_estimate import uneven_clocks
from leapgap.robot.model import Robot
from leapgap.runtime.output_folder import whole_folder
from stages.common import output_folder, read_config, run_stage
from stages.robot import load_robot

STAGE = "stages.chunk"
CLAIMED, OWN = "claimed", "own"
"""Clocks that windows are cut by: what a log claims, or its own where its rows are uneven."""


@dataclass
class ChunkSettings:
    """Section ``chunk`` of the configuration: folders, and the time grid of the windows."""

    logs: str
    contact_step_s: float
    flight_step_s: float
    steps: int
    force: str
    clock: str
    out: str | None = None

    @property
    def grid(self) -> TimeGrid:
        """Time grid of a window."""
        return TimeGrid(self.contact_step_s, self.flight_step_s, self.steps)


def chunk(config: DictConfig) -> None:
    """Read a folder of jump logs and write their windows."""
    section = read_config(ChunkSettings, config.chunk, "chunk")
    out = output_folder(section.out, STAGE, [section.logs, config.robot.model])
    robot = load_robot(config)
    readings = read_folder(Path(section.logs), robot)
    clocks = clocks_of(list(readings.logs), robot, section.clock)
    extracted = window_extraction.cut(list(readings.logs), section.grid, robot, section.force, clocks)
    for line in readings.lines():
        print(line)
    if section.clock == OWN:
        print(f"{len(clocks)} of {len(readings.logs)} logs cut by their own clock")
    with whole_folder(out, STAGE) as folder:
        windows.write(extracted, folder)
    print(
        "no logs: no windows" if not len(extracted) else f"{len(extracted)} windows of {len(extracted.jumps)} jumps",
        "->",
        out,
    )


def clocks_of(logs: Sequence[Log], robot: Robot, clock: str) -> dict[str, RowClock]:
    """Clocks of the logs that are cut by their own, by name; none where claimed ones are asked for."""
    if clock not in (CLAIMED, OWN):
        raise InputError("chunk.clock", clock, f"{CLAIMED} or {OWN}", "correct conf/chunk")
    return uneven_clocks(logs, robot.joints) if clock == OWN else {}


if __name__ == "__main__":
    run_stage(chunk)
