"""One recording -> one denser recording."""
