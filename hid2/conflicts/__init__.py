"""The paper's three conflict cases."""
