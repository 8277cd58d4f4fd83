"""The physics that cases are generated with: integrator, step, friction cone and contacts of the feet."""

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.errors import InputError


@dataclass(frozen=True)
class Physics:
    """How the generating simulation differs from the diagnosing one."""

    name: str
    integrator: mujoco.mjtIntegrator
    impedance: tuple[float, float, float]
    """First numbers of MuJoCo's ``solimp`` of the feet: impedance at the surface and below, width, m."""
    step_s: float | None = None
    """Time step; None: that of the setup."""
    cone: mujoco.mjtCone | None = None
    """Friction cone; None: that of the model."""
    friction_impedance: float | None = None
    """MuJoCo's ``impratio``; None: that of the model."""
    contact_time: float = 1.0
    """Factor on the time constant of the feet's contacts; below one they are stiffer."""
    accepted: tuple[str, ...] = ()
    """Effects that a diagnosis may name besides, since this physics has them."""

    def change_model(self, model: mujoco.MjModel, feet: np.ndarray) -> None:
        """Put the physics into a model; ``feet`` are the geoms of the feet."""
        model.geom_solref[feet, 0] *= self.contact_time
        model.geom_solimp[feet, :3] = self.impedance
        model.opt.integrator = int(self.integrator)
        if self.cone is not None:
            model.opt.cone = int(self.cone)
        if self.friction_impedance is not None:
            model.opt.impratio = self.friction_impedance


INTEGRATOR, CONE = mujoco.mjtIntegrator, mujoco.mjtCone
USUAL = Physics("usual", INTEGRATOR.mjINT_EULER, (0.88, 0.955, 0.0012))
"""That of every case whose kind asks for no other."""
IMPLICIT = Physics("implicit", INTEGRATOR.mjINT_IMPLICIT, USUAL.impedance)
"""That of robots whose diagnosing simulation uses Euler's method, as the usual one does."""
OTHERS: Mapping[str, Physics] = {
    physics.name: physics
    for physics in (
        Physics("pyramidal", INTEGRATOR.mjINT_IMPLICIT, (0.9, 0.95, 0.001), 0.0005, CONE.mjCONE_PYRAMIDAL, 10.0),
        Physics("discrete", INTEGRATOR.mjINT_DISCRETE, (0.85, 0.97, 0.002), 0.0002, CONE.mjCONE_ELLIPTIC, 20.0),
        Physics(
            "stiff",
            INTEGRATOR.mjINT_RK4,
            (0.95, 0.99, 0.0005),
            0.000125,
            CONE.mjCONE_ELLIPTIC,
            contact_time=0.3,
            accepted=("foot_compliance",),
        ),
    )
}
"""Physics that are unlike the diagnosing one in other ways, by name."""


def physics_of(name: str) -> Physics:
    """The physics of this name; an unknown name is an ``InputError``."""
    known = {USUAL.name: USUAL, IMPLICIT.name: IMPLICIT, **OTHERS}
    if name not in known:
        raise InputError("withhold", f"physics {name}", f"one of {', '.join(known)}", "correct the name")
    return known[name]
