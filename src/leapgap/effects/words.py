"""Names of effects and of their numbers in words, for people who do not know those of the code."""

import re

from leapgap import effects


def effect_words(name: str) -> str:
    """What an effect is, such as ``viscous friction``; the name of one that only its user knows."""
    kind = effects.known().get(name)
    return effects.describe(kind) if kind else name.replace("_", " ")


def label_words(label: str) -> str:
    """An effect and its place: ``viscous friction at elbow`` for ``joint_damping at elbow``."""
    name, at, place = label.partition(" at ")
    return f"{effect_words(name)}{at}{place}"


def parameter_words(name: str) -> str:
    """A number of an effect without the unit in its name: ``torque`` for ``torque_nm``, ``torque (N·m)`` likewise."""
    return re.sub(r"_(kg_m|rad_nm|rad_s|s_rad|per_s|kg|nm|rad|m|s|v)(?= \(|$)", "", name).replace("_", " ")


def sentence_words(sentence: str) -> str:
    """A sentence of a report without names of code: ``viscous friction (at elbow: damping 0.4 N·m·s/rad)``."""
    names, numbers = "|".join(effects.known()), {p for kind in effects.known().values() for p in kind.declarations()}
    plain = re.sub(rf"\((?:{names})(?: (at [^():]+))?: ", lambda found: f"({found[1]}: " if found[1] else "(", sentence)
    plain = re.sub(rf"\b(?:{'|'.join(numbers)})(?= [-\d])", lambda found: parameter_words(found[0]), plain)
    return re.sub(rf"\b(?:{names})\b", lambda found: effect_words(found[0]) if "_" in found[0] else found[0], plain)
