"""Which causes a record shows: sets of causes compared by their evidence, together with remainders."""
