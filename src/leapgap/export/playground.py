"""Randomisation for MuJoCo Playground."""

from pathlib import Path

from leapgap.export.base import CorrectedRobot, Export
from leapgap.runtime.atomic_io import write_text

SOURCE = '''\
"""A corrected robot for MuJoCo Playground 0.2: `domain_randomize` is the `randomization_fn` of a training.

Each environment gets one robot of `posterior.npz`, which must lie beside this file: correlated numbers are
drawn together. The environment's model must have the joints, bodies and feet of `robot.xml` by name:
`functools.partial(domain_randomize, mj_model=env.mj_model)`. SI units.
"""

from pathlib import Path

import jax
import numpy as np

SAMPLES = Path(__file__).with_name("posterior.npz")


def domain_randomize(model, rng, mj_model):
    """The model with a leading axis of robots, and which of its fields have it; `rng` holds a key for each robot."""
    with np.load(SAMPLES) as file:
        table = {name: file[name] for name in file.files}
    dofs = np.array([int(mj_model.joint(name).dofadr[0]) for name in table["joints"].tolist()])
    known = {mj_model.body(i).name: i for i in range(mj_model.nbody)}
    bodies = {i: known[name] for i, name in enumerate(table["bodies"].tolist()) if name in known or name != f"body_{i}"}
    feet = [mj_model.geom(name).id for name in table["feet"].tolist()]
    drawn = {key: jax.numpy.asarray(table[key]) for key in table if table[key].dtype.kind == "f"}
    joint_fields = {"dof_damping": "damping", "dof_frictionloss": "friction", "dof_armature": "armature"}
    body_fields = ("body_mass", "body_ipos", "body_inertia", "body_iquat")

    @jax.vmap
    def one(key):
        row = jax.random.randint(key, (), 0, len(table["damping"]))
        of_joints = [getattr(model, field).at[dofs].set(drawn[of][row]) for field, of in joint_fields.items()]
        at, columns = np.array(list(bodies.values())), np.array(list(bodies))
        of_bodies = [getattr(model, field).at[at].set(drawn[field][row][columns]) for field in body_fields]
        friction = model.geom_friction
        if feet:
            friction = friction.at[np.array(feet), 0].set(drawn["foot_friction"][row])
        return (*of_joints, *of_bodies, friction)

    fields = dict(zip((*joint_fields, *body_fields, "geom_friction"), one(rng)))
    in_axes = jax.tree_util.tree_map(lambda _: None, model)
    return model.tree_replace(fields), in_axes.tree_replace(dict.fromkeys(fields, 0))
'''


class Playground(Export):
    """Python for MuJoCo Playground."""

    name = "for_playground.py"
    says = "`domain_randomize` for MuJoCo Playground 0.2, drawn together"

    def write(self, folder: Path, corrected: CorrectedRobot) -> None:
        """Write the Python file."""
        write_text(folder / self.name, SOURCE)
