"""A graph cut across processes: who runs what, what they tell each other, one host's part."""
