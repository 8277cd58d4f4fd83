"""The engine: one linear-Gaussian model of what logs and simulation differ by, from which all answers are read.

``intervals`` cuts logs into short intervals and replays each from the log; ``responses`` linearises them in states,
forces and effects; ``whitening`` is the Kalman filter that makes errors and columns independent; ``evidence`` holds
their inner products; ``search`` finds the set of effects; ``verdict`` says what is known.
"""
