"""The nominal robot: MuJoCo model, topology, kinematics, motors, motion."""
