"""Writes the controller of one jump as files that run without leapgap: C, and for goal-shift MPC NumPy and ONNX."""
