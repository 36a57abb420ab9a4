"""Search for causes: candidates ranked, accepted, refined; what remains unexplained."""
