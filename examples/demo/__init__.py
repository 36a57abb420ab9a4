"""The main job on a simulated joint, end to end."""
