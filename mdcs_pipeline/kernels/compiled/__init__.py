"""Loops compiled by numba; everything else in `kernels` is plain numpy."""
