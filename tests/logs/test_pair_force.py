"""The layout of pair forces: which entry is whose, and what holds for a pair holds for both its axes."""

import numpy as np

from leapgap.logs.pair_force import FORCE_X, FORCE_Z, FRONT_X, FRONT_Z, REAR_X, REAR_Z, by_pair, flat, per_axis
from leapgap.logs.schema import PAIR_FORCE_AXES


def test_names_slices_and_indices_say_the_same() -> None:
    assert PAIR_FORCE_AXES == ("front_x", "front_z", "rear_x", "rear_z")
    assert PAIR_FORCE_AXES[FORCE_X] == ("front_x", "rear_x")
    assert PAIR_FORCE_AXES[FORCE_Z] == ("front_z", "rear_z")
    named = [PAIR_FORCE_AXES[index] for index in (FRONT_X, FRONT_Z, REAR_X, REAR_Z)]
    assert named == list(PAIR_FORCE_AXES)


def test_the_contact_of_a_pair_acts_on_both_its_axes() -> None:
    front_only = np.array([[True, False], [False, False]])
    force = np.arange(1.0, 9.0).reshape(2, 4)
    assert (force * per_axis(front_only)).tolist() == [[1.0, 2.0, 0.0, 0.0], [0.0] * 4]
    assert per_axis(front_only[0]).tolist() == [True, True, False, False]
    assert per_axis([2, 1]).tolist() == [2, 2, 1, 1]


def test_forces_by_pair_and_flat_again() -> None:
    force = np.arange(24.0).reshape(2, 3, 4)
    pairs = by_pair(force)
    assert pairs.shape == (2, 3, 2, 2)
    assert (pairs[..., 1, 0] == force[..., REAR_X]).all()
    assert (pairs[..., 0, 1] == force[..., FRONT_Z]).all()
    assert (flat(pairs) == force).all()
