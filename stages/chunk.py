"""Cut jump logs into the windows that models are trained and evaluated on.

Examples:

    python -m stages.chunk chunk.logs=data/jumps/simulated chunk.out=windows
    python -m stages.chunk chunk.logs=jumps chunk.flight_step_s=0.05 chunk.out=windows
"""

from omegaconf import DictConfig

from leapgap.jumping.learning import windows
from leapgap.jumping.learning.window_extraction import ChunkSettings, cut_folder
from leapgap.runtime.output_folder import whole_folder
from stages.common import output_folder, read_config, run_stage
from stages.robot import load_robot

STAGE = "stages.chunk"


def chunk(config: DictConfig) -> None:
    """Read a folder of jump logs and write their windows."""
    settings = read_config(ChunkSettings, config.chunk, "chunk")
    out = output_folder(settings.out, STAGE, [settings.logs, config.robot.model])
    extracted = cut_folder(settings, load_robot(config), print)
    with whole_folder(out, STAGE) as folder:
        windows.write(extracted, folder)
    found = f"{len(extracted)} windows of {len(extracted.jumps)} jumps" if len(extracted) else "no logs: no windows"
    print(f"{found} -> {out}")


if __name__ == "__main__":
    run_stage(chunk)
