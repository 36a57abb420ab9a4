"""References for the tests of the model: published values and an independent brute-force calculation."""
