"""Units that logs of others come in, by name, and what turns their values into SI."""

import math

from leapgap.errors import InputError, did_you_mean
from leapgap.logs.schema import quantity_of

TURN, INCH, FOOT, POUND, GRAVITY = 2 * math.pi, 0.0254, 0.3048, 4.4482216152605, 9.80665
FINE = {"decideg": TURN / 3600, "centideg": TURN / 36000, "tick4096": TURN / 4096}
"""What drives count angles in."""
UNITS: dict[str, dict[str, float]] = {
    "s": {"s": 1, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60},
    "rad": {"rad": 1, "mrad": 1e-3, "deg": TURN / 360, "rev": TURN} | FINE,
    "rad/s": {"rad/s": 1, "mrad/s": 1e-3, "deg/s": TURN / 360, "rpm": TURN / 60, "rev/s": TURN}
    | {f"{unit}/s": factor for unit, factor in FINE.items()},
    "m": {"m": 1, "cm": 1e-2, "mm": 1e-3, "in": INCH, "ft": FOOT},
    "m/s": {"m/s": 1, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1 / 3.6},
    "m/s²": {"m/s²": 1, "m/s2": 1, "m/s^2": 1, "mm/s2": 1e-3, "g": GRAVITY},
    "N": {"N": 1, "mN": 1e-3, "kN": 1e3, "kgf": GRAVITY, "lbf": POUND},
    "N·m": {
        "N·m": 1,
        "Nm": 1,
        "mNm": 1e-3,
        "Ncm": 1e-2,
        "Nmm": 1e-3,
        "kNm": 1e3,
        "kgfcm": GRAVITY * 1e-2,
        "ozfin": POUND / 16 * INCH,
        "lbfft": POUND * FOOT,
    },
    "N·m/rad": {"N·m/rad": 1, "Nm/rad": 1, "Nm/deg": 360 / TURN, "Nm/rev": 1 / TURN},
    "N·m·s/rad": {"N·m·s/rad": 1, "Nms/rad": 1, "Nms/deg": 360 / TURN, "Nm/rpm": 60 / TURN},
    "V": {"V": 1, "mV": 1e-3},
    "N/m": {"N/m": 1, "N/mm": 1e3},
    "N·s/m": {"N·s/m": 1, "Ns/m": 1, "Ns/mm": 1e3},
}
"""Our unit → names of units of the same dimension → factor from them to ours."""
OF_SLIDES = {"rad": "m", "rad/s": "m/s", "N·m": "N", "N·m/rad": "N/m", "N·m·s/rad": "N·s/m"}
"""What the quantities of joints are measured in where the joint slides."""


def unit_factor(column: str, unit: str, where: str) -> float:
    """What values of a column of ours are multiplied by that are logged in ``unit``.

    Columns of joints take lengths and forces too, because a joint may slide.
    """
    quantity = quantity_of(column)
    ours = "s" if column == "time" else quantity.unit if quantity else None
    known = dict(UNITS.get(ours or "", {}))
    if quantity is not None and quantity.per == "joint":
        known |= UNITS[OF_SLIDES[quantity.unit]]
    if unit not in known:
        expected = f"one of {', '.join(known)}" if known else "a column that has a unit"
        raise InputError(
            f"{where}, {column}",
            f"the unit {unit}",
            expected,
            did_you_mean(unit, known) or "correct it, or use factors",
        )
    return float(known[unit])
