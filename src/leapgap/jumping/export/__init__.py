"""Writes the goal-shift controller of one jump as files that run without leapgap: C, NumPy, ONNX."""
