"""netconvert."""
