"""Columns of samples, the alignment of streams and the rules for clocks: shared by live and offline use."""
