"""What the model is tested against: published values and an independent brute-force calculation."""
