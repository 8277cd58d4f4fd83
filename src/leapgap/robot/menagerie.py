"""Robots of MuJoCo Menagerie by name, through the package ``mujoco-menagerie``, which the extra ``menagerie`` installs.

The package holds a list of robots. It takes their files from the folder that ``MENAGERIE_ROOT`` names, a checkout of
Menagerie, or from its own cache, which it fills by a download when a robot is first asked for.
"""

from pathlib import Path

from leapgap.errors import InputError, did_you_mean, needs

PREFIX = "menagerie:"
"""Before the name of a robot: ``menagerie:unitree_go2`` is its scene with a floor, where its makers have one.
``menagerie:unitree_go2/go2`` names one of its files without ``.xml``."""


def model_file(model: Path | str) -> Path:
    """The model file that a path or a name in Menagerie stands for; ``InputError`` where Menagerie does not have it."""
    given = str(model)
    if not given.startswith(PREFIX):
        return Path(model)
    robot, _, entry = given.removeprefix(PREFIX).partition("/")
    with needs("menagerie"):
        import mujoco_menagerie as menagerie
    try:
        return Path(menagerie.get(robot).xml(entry or None))
    except menagerie.UnknownRobotError:
        found = f"no robot {robot}" if robot else "no name of a robot"
        do = did_you_mean(robot, menagerie.names()) or "mujoco-menagerie names, in a shell, lists them"
        raise InputError(given, found, f"one of the {len(menagerie.names())} robots of MuJoCo Menagerie", do) from None
    except menagerie.UnknownEntryPointError:
        known = ", ".join(menagerie.get(robot).entry_names)
        raise InputError(given, f"no file {entry}", f"one of {known}", f"name one: {PREFIX}{robot}/<file>") from None
    except (menagerie.MenagerieError, OSError) as error:
        raise InputError(
            given,
            f"no files of that robot ({' '.join(str(error).split())})",
            "a checkout of MuJoCo Menagerie in the folder that MENAGERIE_ROOT names, or a network to download from",
            f"set MENAGERIE_ROOT, or run 'mujoco-menagerie prefetch {robot}' where there is a network",
        ) from None
