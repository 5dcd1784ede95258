"""From images to extinction: carving, priors, stages, solvers, uncertainty, checkpoints."""

import logging

# A library does not decide where messages go; this is the part that has any.
logging.getLogger("cloudtomo_cl").addHandler(logging.NullHandler())
