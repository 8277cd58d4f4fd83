"""The table of effects that ``leapgap effects`` prints."""

from leapgap import effects
from leapgap.effects.base import Effect
from leapgap.robot.model import Robot


def effect_rows(robot: Robot | None) -> list[tuple[str, ...]]:
    """Cells of the table of effects, its head first; with the nominal values and ranges of a robot, if there is one."""
    rows: list[tuple[str, ...]] = [("effect", "parameter", "unit", "nominal", "searched", "acts at", "what it is")]
    for kind in effects.known().values():
        missing = None if robot is None else kind.lacks(robot)
        places = {"none": "the robot"}.get(kind.places, kind.places)
        what = effects.describe(kind) + when_looked_for(kind)
        if robot is not None and missing is None:
            of_robot = {
                p.name: (f"{p.nominal:g}", f"{p.lower + 0.0:.3g} to {p.upper:.3g}") for p in kind.parameters(robot)
            }
        else:
            of_robot = {}
        for name, about in kind.declarations().items():
            nominal = "the model's own" if about.nominal is None else f"{about.nominal:g}"
            default = (nominal, f"needs {missing}" if missing else "see: leapgap effects ROBOT")
            called = kind.name if robot is None else kind.called(robot)
            rows.append((called, name, about.unit, *of_robot.get(name, default), places, what))
    return rows


def when_looked_for(kind: type[Effect]) -> str:
    """What stands behind an effect that is not among the usual ones; nothing behind the others."""
    if kind.by_default:
        return ""
    also = ", or with uneven time stamps" if kind.beside_clock else ""
    return f" (searched if named{also})"
