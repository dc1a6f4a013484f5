"""Pure functions on arrays: the arithmetic of the method."""
