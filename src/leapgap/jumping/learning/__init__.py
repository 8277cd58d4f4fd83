"""Residual models of the single rigid body, their training and their rivals."""
