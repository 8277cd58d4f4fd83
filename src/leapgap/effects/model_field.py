"""Any number of a model file as an effect: a field of MuJoCo's model at one of its elements, as a setting names it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from math import inf

import mujoco
import numpy as np

from leapgap.effects.base import Effect, Parameter, parameter, recompute_constants
from leapgap.errors import InputError
from leapgap.robot.model import Robot

Row = Callable[[mujoco.MjModel, str], int]  # index of the row of a field that belongs to an element of a name

ROWS: dict[str, Row] = {
    "body": lambda model, name: int(model.body(name).id),
    "dof": lambda model, name: int(model.joint(name).dofadr[0]),
    "eq": lambda model, name: int(model.equality(name).id),
    "geom": lambda model, name: int(model.geom(name).id),
    "jnt": lambda model, name: int(model.joint(name).id),
    "qpos": lambda model, name: int(model.joint(name).qposadr[0]),
    "site": lambda model, name: int(model.site(name).id),
    "tendon": lambda model, name: int(model.tendon(name).id),
}
"""First part of a field's name → row of an element."""
WHOLE = "opt"  # first part of the name of a field of the whole simulation, such as ``opt.density``
NOT_OURS = ("opt.timestep",)  # fields that the replay sets for itself: the step is the effect ``numerics``
FRAMES = {
    "body_ipos": ("body_sameframe", "geom_sameframe"),
    "body_iquat": ("body_sameframe", "geom_sameframe"),
    "geom_pos": ("geom_sameframe",),
    "geom_quat": ("geom_sameframe",),
    "site_pos": ("site_sameframe",),
    "site_quat": ("site_sameframe",),
}
"""Fields that move a frame, and the marks of frames that coincide, which then hold no longer."""
MODERATE = 0.1  # noticeable departure, as a share of the way from the model's own value to the farther end of the range


@dataclass(frozen=True)
class ModelField:
    """One number of a model, and the range in which a diagnosis looks for it.

    ``{field: dof_damping, element: knee, lower: 0, upper: 4}`` is the damping of the joint ``knee``.
    """

    field: str
    """Name of the field in ``mjModel``: ``dof_damping``, ``geom_friction``, ``body_mass``, ``opt.impratio``."""
    lower: float
    upper: float
    """Range that is searched, in the unit of the field; the model's own value lies within. A lower end of 0 is an
    answer, any other end is none."""
    element: str = ""
    """Name of the body, joint, geom, site, tendon or equality; empty for a field of the whole simulation."""
    entry: int = 0
    """Which number, where the field has several of an element."""
    moderate: float | None = None
    """Noticeable value; by default a tenth of the way to the farther end."""
    unit: str = ""

    def __post_init__(self) -> None:
        """Refuse what names no field with a range."""
        if not -inf < self.lower < self.upper < inf:
            expected = "lower below upper, both finite"
            raise InputError(self.where, f"{self.lower:g} to {self.upper:g}", expected, "correct the range")
        first = self.field.partition("." if self.field.startswith(f"{WHOLE}.") else "_")[0]
        if (first not in ROWS and first != WHOLE) or self.field in NOT_OURS:
            expected = f"a field of mjModel that begins with {', '.join(f'{one}_' for one in ROWS)} or {WHOLE}."
            raise InputError(self.where, f"the field {self.field}", expected, "choose another field")

    @property
    def where(self) -> str:
        """How errors name this setting."""
        return f"model_fields, {self.name}"

    @property
    def name(self) -> str:
        """Name of the effect: ``dof_damping_knee``, with the entry where it is not the first."""
        parts = [self.field.replace(".", "_"), self.element, str(self.entry) if self.entry else ""]
        return "_".join(part for part in parts if part)

    @property
    def option(self) -> str | None:
        """Name of the field in ``mjOption``, where it is one of the whole simulation."""
        return self.field.removeprefix(f"{WHOLE}.") if self.field.startswith(f"{WHOLE}.") else None

    def row(self, model: mujoco.MjModel) -> int:
        """The row of the element in its field."""
        try:
            return ROWS[self.field.partition("_")[0]](model, self.element)
        except KeyError as error:
            message = " ".join(str(error.args[0]).split())
            raise InputError(self.where, message, "an element of the model", "correct the name") from None

    def place(self, model: mujoco.MjModel) -> tuple[np.ndarray, tuple[int, ...]]:
        """The array of a model that holds the number, and its index there; ``InputError`` where there is none."""
        values = getattr(model.opt, self.option, None) if self.option else getattr(model, self.field, None)
        if not isinstance(values, np.ndarray) or values.dtype.kind != "f":
            raise InputError(self.where, f"no numbers in {self.field}", "a field of real numbers", "correct the field")
        row = () if self.option else (self.row(model),)
        index = (*row, *([self.entry] if values.ndim > len(row) else []))
        if len(index) == values.ndim and all(i < n for i, n in zip(index, values.shape, strict=True)):
            return values, index
        raise InputError(self.where, f"entry {self.entry}", f"an entry of {values.shape[1:]}", "correct the entry")

    def is_single(self, model: mujoco.MjModel) -> bool:
        """Whether the field is one real number of the whole simulation."""
        return self.option is not None and isinstance(getattr(model.opt, self.option, None), float)

    def own(self, model: mujoco.MjModel) -> float:
        """The number as the model file has it."""
        if self.option and self.is_single(model):
            return float(getattr(model.opt, self.option))
        values, index = self.place(model)
        return float(values[index])

    def put(self, model: mujoco.MjModel, value: float) -> None:
        """Set the number in a model, and what MuJoCo derives from it."""
        if self.option and self.is_single(model):
            setattr(model.opt, self.option, value)
            return
        values, index = self.place(model)
        values[index] = value
        for mark in FRAMES.get(self.field, ()):
            of_body = self.field.startswith("body_") and mark == "geom_sameframe"
            rows = model.geom_bodyid == index[0] if of_body else index[0]
            getattr(model, mark)[rows] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)
        recompute_constants(model)


@cache
def effect_class(of: ModelField) -> type[Effect]:
    """The effect whose one parameter stands in place of a number of the model; one class for each field."""

    @dataclass(frozen=True)
    class FieldValue(Effect):
        name = of.name

        value: float | None = parameter(None, of.unit, of.lower, of.upper, limits=(-inf, inf))

        @classmethod
        def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
            """From the model's own value to the ends of the stated range."""
            own = of.own(robot.model)
            if not of.lower <= own <= of.upper:
                expected = f"a range that holds the model's own {own:g}"
                raise InputError(of.where, f"{of.lower:g} to {of.upper:g}", expected, "widen the range")
            moderate = of.moderate
            if moderate is None:
                moderate = own + MODERATE * max(of.upper - own, of.lower - own, key=abs)
            found = Parameter("value", of.unit, own, of.lower, of.upper, moderate, own)
            return (replace(found, lower_is_physical=of.lower == 0),)

        def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
            """Put the value in place of the model's own."""
            if self.value is not None and not self.is_nominal_for(robot):
                of.put(model, self.value)

    at = f" of {of.element}" if of.element else ""
    FieldValue.__doc__ = f"Another {of.field}{at} than the model has."
    FieldValue.__module__ = FieldValue.__qualname__ = of.name  # it is the user's, in no file of this package
    return FieldValue
