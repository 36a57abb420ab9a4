"""Joints in bags and tables: topics of their signals, and their records for a diagnosis."""
