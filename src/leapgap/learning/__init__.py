"""Networks that are trained from logs of any robot, beside what a diagnosis names: extra ``learning``."""
