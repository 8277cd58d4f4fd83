"""Robots as their owners bring them: errors of drives, models and logs, made by plain MuJoCo.

Nothing here uses effects or replays of the diagnosis: the joint PD, the errors and the steps are written by hand.
"""
