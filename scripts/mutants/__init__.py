"""Sites where scripts/mutate.py changes one operator: of Python by its syntax tree, of OpenCL C by its tokens."""
