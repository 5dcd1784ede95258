"""From images to extinction: carving, priors, stages, solvers, uncertainty, checkpoints."""
