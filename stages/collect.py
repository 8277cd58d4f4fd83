"""Stage ``collect``: logs of simulated jumps, on hardware with effects that the controller does not know.

Examples:

    python -m stages.collect collect.target=[0.6,0.0] collect.hardware=worn collect.jumps=5 collect.out=jumps
    python -m stages.collect -m collect.hardware=ideal,damped collect.jumps=1
"""

from pathlib import Path

import numpy as np
from omegaconf import DictConfig

from leapgap.effects.base import Effect
from leapgap.jumping.experiments.collecting import (
    CollectSettings,
    describe_result,
    hidden_effects,
    method_of,
    targets_of,
)
from leapgap.jumping.experiments.collection import CollectionSpec
from leapgap.jumping.experiments.method import crouch
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.experiments.trial import TrialSetup
from leapgap.jumping.models.planar import planar_robot
from leapgap.jumping.models.rigid_body import RigidBody
from leapgap.jumping.models.rigid_body_model import planner_body
from leapgap.jumping.planning.reference_store import reference_to
from leapgap.logs import log as jump_log
from leapgap.robot.model import Robot
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
    robot, corrections = robot_of(settings, config)
    effects = (*corrections, *hidden_effects(settings.variants, settings.hardware, settings.hardware_seed))
    rng = np.random.default_rng(settings.seed)
    targets = targets_of(settings, rng)
    references = {target: reference_to(target, Path(settings.references), planar_robot(robot)) for target in targets}
    controller_body = read_optional(RigidBody, config.robot.get("body"), "robot.body")
    body = read_optional(RigidBody, config.collect.body, "collect.body") or planner_body(
        robot, crouch(references, robot), controller_body
    )
    method = method_of(settings, robot, references, body)
    world = TrialSetup(robot, settings.sensing, course=settings.course, body=body)
    planned = []
    for i, target in enumerate(targets):
        block = round(float(rng.uniform(*settings.block_height_m)), 4)
        task = JumpTask("collect", target.x_m, target.z_m, block_m=(block, block))
        seed = int(rng.integers(2**31))
        planned.append(
            CollectionSpec(f"{settings.hardware}_{i:02d}", task, method, effects, world, seed, settings.excitation)
        )
    with whole_folder(out, STAGE) as folder:
        for result in executor.map(CollectionSpec.run, planned):
            jump_log.write_log(result.log, folder / f"{result.log.name}.parquet")
            print(describe_result(result), flush=True)


def robot_of(settings: CollectSettings, config: DictConfig) -> tuple[Robot, tuple[Effect, ...]]:
    """The nominal robot, or a corrected one with the effects a diagnosis found."""
    if settings.robot is None:
        return load_robot(config), ()
    return read_corrected(Path(settings.robot))


if __name__ == "__main__":
    run_stage(collect)
