"""The robot we believe in: parameters, kinematics, nominal dynamics, contact schedule, MuJoCo model."""
