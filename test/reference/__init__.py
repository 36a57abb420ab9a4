"""References for the model: published values and an independent brute-force calculation."""
