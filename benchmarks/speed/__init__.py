"""How fast: ratios to peers measured in turn in one run, growth, bandwidth and start-up."""
