"""The whole work flow on a simulated joint."""
