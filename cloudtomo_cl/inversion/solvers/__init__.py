"""The solvers: each consists of a few functions of a problem and a state."""
