"""The solvers: each a few functions of a problem and a state."""
