"""Benchmark of scenes that accumulate: cost, stability and topology of the streamed skeleton."""
