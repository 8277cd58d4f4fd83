"""The MuJoCo world: replay of a log, and a controller that makes one."""
