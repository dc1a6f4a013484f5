"""The stages, one a file; each is found by its entry point."""
