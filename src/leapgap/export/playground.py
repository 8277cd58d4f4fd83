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
    dofs = [int(mj_model.joint(name).dofadr[0]) for name in table["joints"].tolist()]
    bodies = [0 if i == 0 else mj_model.body(name).id for i, name in enumerate(table["bodies"].tolist())]
    feet = [mj_model.geom(name).id for name in table["feet"].tolist()]
    drawn = {key: jax.numpy.asarray(table[key]) for key in table if table[key].dtype.kind == "f"}

    @jax.vmap
    def one(key):
        row = jax.random.randint(key, (), 0, len(table["damping"]))
        changed = (
            model.dof_damping.at[np.array(dofs)].set(drawn["damping"][row]),
            model.dof_frictionloss.at[np.array(dofs)].set(drawn["friction"][row]),
            model.dof_armature.at[np.array(dofs)].set(drawn["armature"][row]),
            model.body_mass.at[np.array(bodies)].set(drawn["body_mass"][row]),
            model.body_ipos.at[np.array(bodies)].set(drawn["body_ipos"][row]),
            model.body_inertia.at[np.array(bodies)].set(drawn["body_inertia"][row]),
            model.body_iquat.at[np.array(bodies)].set(drawn["body_iquat"][row]),
        )
        friction = model.geom_friction
        if feet:
            friction = friction.at[np.array(feet), 0].set(drawn["foot_friction"][row])
        return (*changed, friction)

    names = ("dof_damping", "dof_frictionloss", "dof_armature", "body_mass", "body_ipos", "body_inertia", "body_iquat")
    fields = dict(zip((*names, "geom_friction"), one(rng)))
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
