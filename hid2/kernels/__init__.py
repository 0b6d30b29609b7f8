"""Compiled loops: a change of these files, and of no others, costs a recompile."""
