"""Benchmarks that anyone can rerun; they are not part of the installed package."""
