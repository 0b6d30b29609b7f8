"""Compiled loops: the only files whose change costs a recompile."""
