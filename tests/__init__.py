"""A package, so that a Python environment with a package of this name does not hide it."""
