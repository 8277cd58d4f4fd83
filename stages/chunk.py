"""Cut jump logs into the windows that models are trained and evaluated on.

Examples:

    python -m stages.chunk chunk.logs=data/jumps/simulated chunk.out=windows
    python -m stages.chunk chunk.logs=jumps chunk.flight_step_s=0.05 chunk.out=windows
"""

from dataclasses import dataclass
from pathlib import Path

from omegaconf import DictConfig

from leapgap.jumping.learning import window_extraction, windows
from leapgap.jumping.learning.windows import TimeGrid
from leapgap.logs.reading import read_folder
from leapgap.output_folder import whole_folder
from stages.common import output_folder, read_config, run_stage
from stages.robot import load_robot

STAGE = "stages.chunk"


@dataclass
class ChunkSettings:
    """Section ``chunk`` of the configuration: folders, and the time grid of the windows."""

    logs: str
    contact_step_s: float
    flight_step_s: float
    steps: int
    force: str
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
    extracted = window_extraction.cut(list(readings.logs), section.grid, robot, section.force)
    for line in readings.lines():
        print(line)
    with whole_folder(out, STAGE) as folder:
        windows.write(extracted, folder)
    print(
        "no logs: no windows" if not len(extracted) else f"{len(extracted)} windows of {len(extracted.jumps)} jumps",
        "->",
        out,
    )


if __name__ == "__main__":
    run_stage(chunk)
