"""Does a method find the right topology? Shapes with exact truth, damage, scores and peers."""
