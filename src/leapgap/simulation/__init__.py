"""MuJoCo simulation: replay of logs, open loop, and in closed loop with a controller."""
