"""A robot's model as one text that needs no other file: without included files and meshes."""

from pathlib import Path

from leapgap.errors import InputError
from leapgap.robot.model import Robot
from leapgap.robot.model_file import compile_spec, discard_visual

OWN_MODEL = "robot.xml"  # file beside the logs of a withheld case with its robot; without, that of the pipeline


def own_model(logs: Path) -> Path | None:
    """The model of their own that lies in a folder of logs."""
    path = logs / OWN_MODEL
    return path if path.is_file() else None


def self_contained(robot: Robot) -> str:
    """MJCF of a robot with its makers' actuators, its base held where it is, without what only shows.

    ``InputError`` where parts of it collide that are described by further files, meshes or heightfields.
    """
    spec = robot.published_spec()
    discard_visual(spec, robot.path)
    others = [part.name or part.file for part in (*spec.meshes, *spec.hfields, *spec.skins)]
    if others:
        expected = "colliding parts of primitive shapes, which one text can hold"
        raise InputError(robot.path, f"the meshes or heightfields {', '.join(others)}", expected, "replace them")
    compile_spec(spec, robot.path)
    return str(spec.to_xml())
