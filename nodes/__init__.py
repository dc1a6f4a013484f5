"""Hosts that run a pipeline inside another runtime.

A host converts the runtime's messages, calls the pipeline once and publishes
the result. It holds no method of its own.
"""
