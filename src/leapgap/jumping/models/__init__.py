"""Reduced models of a jumping quadruped: planar legs, a rigid body, affine predictions."""
