"""Where vehicles are inserted, and how many."""
