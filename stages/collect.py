"""Stage ``collect``: logs of simulated jumps, on hardware with effects that the controller does not know.

Examples:

    python -m stages.collect collect.target=[0.6,0.0] collect.hardware=worn collect.jumps=5 collect.out=jumps
    python -m stages.collect -m collect.hardware=ideal,damped collect.jumps=1
"""

from pathlib import Path

from omegaconf import DictConfig

from leapgap.jumping.experiments.collecting import CollectSettings, collect_jumps, plan_jumps
from leapgap.jumping.models.rigid_body import RigidBody
from leapgap.runtime.executor import Executor
from leapgap.runtime.output_folder import whole_folder
from leapgap.simulation.corrected import read_corrected
from stages.common import output_folder, read_config, read_optional, run_stage
from stages.robot import load_robot

STAGE = "stages.collect"


def collect(config: DictConfig) -> None:
    """Simulate the configured jumps on the chosen hardware, and write their logs."""
    settings = read_config(CollectSettings, config.collect, "collect")
    executor = read_config(Executor, config.executor, "executor")
    out = output_folder(settings.out, STAGE, (settings.references, settings.robot, config.robot.model))
    corrected = settings.robot and read_corrected(Path(settings.robot))
    robot, corrections = corrected or (load_robot(config), ())
    body = read_optional(RigidBody, config.collect.body, "collect.body")
    rounded = read_optional(RigidBody, config.robot.get("body"), "robot.body")
    planned = plan_jumps(settings, robot, corrections, body, rounded)
    with whole_folder(out, STAGE) as folder:
        collect_jumps(planned, executor, folder)


if __name__ == "__main__":
    run_stage(collect)
