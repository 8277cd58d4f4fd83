"""Layout of the planner's vectors."""

import numpy as np

TRUNK = ("x", "z", "pitch")
JOINTS = ("front_thigh", "front_calf", "rear_thigh", "rear_calf")

# Layout of q and v: position of the trunk, its pitch, the joints of the pairs.
X, Z, PITCH = 0, 1, 2
JOINT = slice(3, 7)
COORDINATES = 7

CROUCH = np.array([-0.4, 0.75, -0.4, 0.75]) * np.pi
"""Joint angles the published jumps start and end with, rad, in the planner's sign."""
