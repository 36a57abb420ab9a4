"""Which causes a record shows: sets of causes compared by their evidence, beside remainders of any joint."""
