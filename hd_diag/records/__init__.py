"""What bags and tables hold of joints: the topics of their signals, and their records for a diagnosis."""
