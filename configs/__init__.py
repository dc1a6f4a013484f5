"""Pipelines that the package ships, by name."""
